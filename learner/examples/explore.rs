#![allow(missing_docs, clippy::all)]
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::atomic::{AtomicU64, Ordering};

use controller::{Controller, Inputs, Intent, Policy, PolicySlot};
use gate::{Counsel, Docket, Rules};
use learner::{Adam, Network, Tape, network::Head};
use planner::Planner;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus as Random;
use shm_config::Instant;
use shm_config::config::planner::Method;
use shm_config::config::{Config, GateMode};
use shm_config::message::{Driver, Header, Observation, Outcome, Plan, Step};
use sim::{World, WorldConfig, score::Score};
use vehicle::Action;

const F: usize = 259;
struct Shared(Rc<RefCell<(Network, Tape)>>, usize);
impl Policy for Shared {
    fn infer(&mut self, f: &[f32]) -> Action {
        let (net, tape) = &mut *self.0.borrow_mut();
        let mut x = f.to_vec();
        prep(&mut x, self.1);
        let o = net.forward(&x, 1, tape);
        Action { steer: o[0] as f64, pedal: o[1] as f64 }
    }
    fn version(&self) -> u64 { 1 }
    fn hash(&self) -> u64 { 1 }
}
fn prep(_x: &mut [f32], mode: usize) {
    if mode == 1 {
        for v in &mut _x[19..] { *v = 1.0 - *v; }
    }
    if mode == 2 {
        // centred and scaled: small-range features get room
        for v in &mut _x[..19] { *v = (*v - 0.5) * 4.0; }
        for v in &mut _x[19..] { *v = 1.0 - *v; }
    }
}
fn env<T: std::str::FromStr>(k: &str, d: T) -> T {
    std::env::var(k).ok().and_then(|v| v.parse().ok()).unwrap_or(d)
}
fn mirror(x: &mut [f32]) {
    let width = (x[0] + x[1]) * 18.0;
    x.swap(0, 1);
    for k in [2, 4, 5, 8] { x[k] = 1.0 - x[k]; }
    for b in [9, 14] {
        x[b + 1] = 1.0 - x[b + 1];
        let extra = (width - 3.5) / 70.5;
        if x[b + 3] == 0.0 { x[b + 2] = (x[b + 2] + extra).min(1.0); } else if x[b + 3] == 1.0 { x[b + 2] = (x[b + 2] - extra).max(0.0); }
        x[b + 3] = 1.0 - x[b + 3];
    }
    x[20..259].reverse();
}
struct Oracle { planner: Planner, controller: Controller, plan: Plan, asked: u32 }
impl Oracle {
    fn new(config: &Config) -> Self {
        let mut c = config.clone(); c.gate.mode = GateMode::Expert;
        Oracle { planner: Planner::new(&c).unwrap(), controller: Controller::new(c, PolicySlot::new(None)), plan: Plan::default(), asked: 0 }
    }
    fn ask(&mut self, obs: &mut Observation) -> [f32; 2] {
        self.asked += 1;
        obs.header.episode = self.asked; obs.header.tick = self.asked as u64; obs.header.taken_ns = self.asked as u64 * 1_000_000_000;
        self.planner.forget();
        self.planner.plan(obs, &mut self.plan);
        let s = self.controller.tick(&Inputs { observation: Some(*obs), plan: Some(self.plan), advice: None }, self.asked as u64, obs.header.taken(), Intent::Drive);
        [s.command.steer as f32, s.command.pedal as f32]
    }
}
fn normal(r: &mut Random) -> f64 { (0..12).map(|_| r.random::<f64>()).sum::<f64>() - 6.0 }
fn imagine(obs: &Observation, r: &mut Random, out: &mut Observation) -> bool {
    let (l, ri) = (obs.road.left_m - 1.2, obs.road.right_m - 1.2);
    let mut st = vehicle::State::at_origin(obs.ego.speed_mps);
    st.position.y = (0.7 * normal(r)).clamp(-ri.max(0.0), l.max(0.0));
    st.heading_rad = 0.12 * normal(r);
    if r.random::<f64>() < 0.3 { st.speed_mps = r.random_range(0.0..8.0); }
    learner::elsewhere::observe(obs, &st, (obs.ego.steer, obs.ego.pedal), out);
    let n = [0, 1, 1, 2][r.random_range(0..4)];
    let curve = match out.checkpoints[0].bend() { shm_config::message::Bend::Left => 1.0 / out.checkpoints[0].bend_radius_m, shm_config::message::Bend::Right => -1.0 / out.checkpoints[0].bend_radius_m, _ => 0.0 };
    for _ in 0..n {
        let x: f64 = r.random_range(4.0..30.0);
        let lat = r.random_range(-out.road.right_m.max(0.1)..out.road.left_m.max(0.2));
        let h = -out.road.heading_rad + curve * x;
        let y = lat + x * (-out.road.heading_rad).sin() + 0.5 * curve * x * x;
        let (hl, hw): (f64, f64) = [(0.2, 0.2), (0.15, 0.8), (2.3, 1.0)][r.random_range(0..3)];
        let pose = vehicle::pose(x, y, h + 0.2 * normal(r));
        if x - hl < 3.5 && y.abs() - hw < 1.5 { continue; }
        let c: Vec<_> = [(hl, hw), (-hl, hw), (-hl, -hw), (hl, -hw)].iter().map(|&(a, b)| pose * vehicle::Point::new(a, b)).collect();
        learner::elsewhere::place(&c, out);
    }
    true
}
/// What the expert would command here.
fn label(step: &Step, brake: bool) -> Option<Action> {
    let a = step.expert.action();
    match a {
        None => Some(Action { steer: 0.0, pedal: -1.0 }),
        Some(a) if brake && step.expert_assessment.is_vetoed() => Some(Action { steer: a.steer, pedal: -1.0 }),
        Some(a) => Some(a),
    }
}
fn evaluate(net: &Network, config: &Config, n: u64, mode: usize, verbose: bool) -> (f64, f64, f64, f64, f64, f64) {
    let next = AtomicU64::new(0);
    let first: u64 = if n == 50 { 100 } else { 1000 };
    let eps: Vec<_> = std::thread::scope(|s| {
        let hs: Vec<_> = (0..2).map(|_| {
            let next = &next;
            s.spawn(move || {
                let mut world = World::new(WorldConfig::from(&config.world)).unwrap();
                let mut tape = Tape::default();
                let mut obs = Box::<Observation>::default();
                let mut out = vec![];
                let mut f = [0f32; 531];
                loop {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    if k >= n { return out; }
                    world.reset(first + k).unwrap();
                    let mut score = Score::new(first + k);
                    let mut t = 0u64;
                    let cmd = Step::default().command;
                    while !world.last_step().has_ended() {
                        world.observe(&mut obs);
                        let x = obs.features(&mut f).unwrap();
                        let mut x = x.to_vec();
                        prep(&mut x, mode);
                        let o = net.forward(&x, 1, &mut tape);
                        let a = Action { steer: o[0] as f64, pedal: o[1] as f64 }.clamped();
                        t += 1;
                        let mut c = cmd; c.steer = a.steer; c.pedal = a.pedal; c.header = Header { taken_ns: (t - 1) * 100_000_000, ..Header::default() };
                        let act = score.obey(Some(&c), Instant(t * 100_000_000));
                        let o = world.step(act);
                        score.count(&o);
                    }
                    out.push(score.episode(&world, world.last_step().outcome));
                }
            })
        }).collect();
        hs.into_iter().flat_map(|h| h.join().unwrap()).collect()
    });
    let m = |f: &dyn Fn(&shm_config::message::Episode) -> f64| eps.iter().map(f).sum::<f64>() / eps.len() as f64;
    if verbose {
        let mut fails: Vec<_> = eps.iter().filter(|e| !e.is_strict_success()).map(|e| (e.seed, format!("{:?}", e.outcome()), e.vehicle_contacts, e.object_contacts, (e.completion * 100.0) as u32, e.ticks)).collect();
        fails.sort();
        for f in fails.iter().take(60) { println!("   {f:?}"); }
    }
    println!("   veh {:.3} obj {:.3} maxstep {:.3}", m(&|e| (e.vehicle_contacts > 0) as u8 as f64), m(&|e| (e.object_contacts > 0) as u8 as f64), m(&|e| (e.outcome() == Outcome::MaxStep) as u8 as f64));
    (m(&|e| (e.outcome() == Outcome::Arrived) as u8 as f64), m(&|e| e.is_strict_success() as u8 as f64), m(&|e| (e.outcome() == Outcome::OutOfRoad) as u8 as f64), m(&|e| (e.vehicle_contacts + e.object_contacts > 0) as u8 as f64), m(&|e| e.completion), m(&|e| e.ticks as f64))
}
fn main() {
    let steps: usize = env("STEPS", 50_000);
    let upd: usize = env("UPD", 200);
    let batch: usize = env("BATCH", 256);
    let lr: f32 = env("LR", 1e-3);
    let hidden: usize = env("HIDDEN", 256);
    let mode: usize = env("PREP", 0);
    let evals: u64 = env("EVALS", 200);
    let who = env("WHO", "gate".to_string());
    let brake: bool = env("BRAKE", 1) == 1;
    let intervened: bool = env("INTERVENED", 0) == 1;
    let seed: u64 = env("SEED", 0);
    let final_updates: usize = env("FINAL", 0);
    let mut config = Config::default();
    config.run.clock = shm_config::config::Clock::Lockstep;
    config.planner.method = match env("EXPERT", "informed".to_string()).as_str() { "mpc" => Method::Mpc, "rrt" => Method::RrtStar, "kino" => Method::Kinodynamic, _ => Method::Informed };
    config.gate.mode = match who.as_str() { "expert" => GateMode::Expert, "policy" => GateMode::Policy, _ => GateMode::Rules };
    config.informed.inflation_m = env("INFL", 1.2);
    config.mpc.clearance_m = env("CLEAR", 1.2);
    config.mpc.speed_mps = env("SPEED", 5.0);
    config.mpc.steps = env("MPCSTEPS", 8);
    config.gate.period_s = env("PERIOD", 10.0);
    config.gate.hold_s = config.gate.period_s + 2.0;
    let imagined: usize = env("IMAGINE", 0);
    let mut oracle = Oracle::new(&config);
    let mut there = Box::<Observation>::default();
    let mut random = Random::seed_from_u64(seed);
    let net = Rc::new(RefCell::new((Network::new(&[F, hidden, hidden, 2], Head::Tanh, &mut random), Tape::default())));
    let mut adam = Adam::new(net.borrow().0.parameters().len(), lr);
    let mut grad = vec![0f32; net.borrow().0.parameters().len()];
    let mut tape = Tape::default();
    let mut tape2 = Tape::default();
    let mut controller = Controller::new(config.clone(), PolicySlot::new(Some(Box::new(Shared(net.clone(), mode)))));
    let mut planner = Planner::new(&config).unwrap();
    let mut counsel = Counsel::new(&config.gate, Docket::immediate(Rules::new(config.vehicle, config.judge)));
    let mut world = World::new(WorldConfig::from(&config.world)).unwrap();
    let mut episode_seed = 100u64 + random.random_range(0..50);
    world.reset(episode_seed).unwrap();
    let mut xs: Vec<f32> = Vec::new();
    let mut ys: Vec<[f32; 2]> = Vec::new();
    let mut obs = Box::<Observation>::default();
    let mut plan = Plan::default();
    let mut advice = None;
    let (mut tick, mut episode) = (0u64, 0u32);
    let mut drivers = [0usize; 3];
    let mut outcomes = [0usize; 4];
    let mut f = [0f32; 531];
    let begun = std::time::Instant::now();
    let (mut bx, mut by, mut delta): (Vec<f32>, Vec<[f32; 2]>, Vec<f32>) = (vec![], vec![], vec![]);
    let mut lossavg = 0.0;
    let mirrored = env("MIRROR", 0) == 1;
    let ema_share: f32 = env("EMA", 1.0);
    let steerw: f32 = env("STEERW", 1.0);
    let mut sls = 0.0f32;
    let mut ema = net.borrow().0.clone();
    let mut update = |ema: &mut Network, n: usize, xs: &Vec<f32>, ys: &Vec<[f32; 2]>, adam: &mut Adam, random: &mut Random| {
        let mut avg = 0.0; let mut sl = 0.0;
        for _ in 0..n {
            bx.clear(); by.clear();
            for _ in 0..batch {
                let i = random.random_range(0..ys.len());
                let at = bx.len();
                bx.extend_from_slice(&xs[i * F..i * F + F]);
                let mut y = ys[i];
                if mirrored && random.random::<bool>() { mirror(&mut bx[at..]); y[0] = -y[0]; }
                prep(&mut bx[at..], mode);
                by.push(y);
            }
            let (net, _) = &mut *net.borrow_mut();
            let out = net.forward(&bx, 1, &mut tape);
            delta.clear();
            let mut loss = 0.0;
            for (o, y) in out.chunks(2).zip(&by) {
                for k in 0..2 { let w = if k == 0 { steerw } else { 1.0 }; let d = o[k] - y[k]; loss += d * d; delta.push(2.0 * w * d / batch as f32); if k == 0 { sl += d * d; } }
            }
            avg += loss / batch as f32;
            grad.fill(0.0);
            net.backward((&bx, &delta), 1, &mut tape, Some(&mut grad), None);
            adam.step(net.parameters_mut(), &grad);
            ema.follow(net, ema_share);
        }
        sls = sl / (n.max(1) * batch) as f32;
        if n > 1000 { println!("steer rms {:.4}", sls.sqrt()); }
        avg / n.max(1) as f32
    };
    for step_no in 0..steps {
        world.observe(&mut obs);
        obs.header = Header { tick, taken_ns: tick * 100_000_000, episode, ..Header::default() };
        planner.plan(&obs, &mut plan);
        let inputs = Inputs { observation: Some(*obs), plan: Some(plan), advice };
        let now = obs.header.taken();
        let step = *controller.tick(&inputs, tick, now, Intent::Drive);
        if who == "gate" { advice = Some(counsel.consider(&step, now)); }
        let x = obs.features(&mut f).unwrap();
        let expert_drove = step.driver() != Driver::Policy;
        if !intervened || expert_drove {
            if let Some(a) = label(&step, brake) {
                xs.extend_from_slice(x);
                ys.push([a.steer as f32, a.pedal as f32]);
            }
        }
        for _ in 0..imagined {
            if imagine(&obs, &mut random, &mut there) {
                let y = oracle.ask(&mut there);
                let x = there.features(&mut f).unwrap();
                xs.extend_from_slice(x);
                ys.push(y);
            }
        }
        drivers[match step.driver() { Driver::Expert => 0, Driver::Policy => 1, Driver::Brake => 2 }] += 1;
        let o = world.step(Action { steer: step.command.steer, pedal: step.command.pedal });
        tick += 1;
        if o.has_ended() {
            outcomes[match o.outcome { Outcome::Arrived => 0, Outcome::OutOfRoad => 1, Outcome::MaxStep => 2, _ => 3 }] += 1;
            episode += 1;
            episode_seed = 100 + random.random_range(0..50);
            world.reset(episode_seed).unwrap();
            planner.forget();
        }
        if (step_no + 1) % 200 == 0 && !ys.is_empty() {
            lossavg = update(&mut ema, upd, &xs, &ys, &mut adam, &mut random);
        }
        if [5000, 10000, 20000, 30000, 40000, 50000].contains(&(step_no + 1)) && step_no + 1 < steps {
            let e = evaluate(&ema, &config, evals.min(200), mode, false);
            println!("{} steps {:.0} s loss {lossavg:.4} drivers {drivers:?} ends {outcomes:?}: success {:.3} strict {:.3} out {:.3} contact {:.3} compl {:.3} len {:.0}", step_no + 1, begun.elapsed().as_secs_f32(), e.0, e.1, e.2, e.3, e.4, e.5);
            drivers = [0; 3]; outcomes = [0; 4];
        }
    }
    if final_updates > 0 {
        for k in 0..4 { adam.rate = lr * [0.3, 0.1, 0.03, 0.01][k]; lossavg = update(&mut ema, final_updates / 4, &xs, &ys, &mut adam, &mut random); }
    }
    let e = evaluate(&ema, &config, evals, mode, env("VERBOSE", 0) == 1);
    if let Ok(sd) = std::env::var("TRACE") {
        let sd: u64 = sd.parse().unwrap();
        world.reset(sd).unwrap();
        let mut last = 0;
        while !world.last_step().has_ended() && world.ticks() < 1200 {
            world.observe(&mut obs);
            let x = obs.features(&mut f).unwrap().to_vec();
            let mut xp = x.clone(); prep(&mut xp, mode);
            let o = ema.forward(&xp, 1, &mut tape2).to_vec();
            let r = obs.ranges();
            let (mut best, mut bk) = (99.0f32, 0i32);
            for d in -25..=25i32 { let k = d.rem_euclid(240) as usize; if r[k] < best { best = r[k]; bk = d; } }
            *there = *obs;
            let y = oracle.ask(&mut there);
            let st = *oracle.controller.step();
            if best < 14.0 && world.ticks() % 2 == 0 { println!("t {} v {:.1} near {:.1} m at {:.1} deg  policy {:+.2} {:+.2}  expert {:+.2} {:+.2} {:?} veto {} clear {:.2}", world.ticks(), obs.ego.speed_mps, best, bk as f32 * 1.5, o[0], o[1], y[0], y[1], st.reason(), st.expert_assessment.is_vetoed(), st.expert_assessment.clearance_m); }
            let out = world.step(Action { steer: o[0] as f64, pedal: o[1] as f64 });
            if out.touch.object && last == 0 { println!("TOUCH object"); last = 1; }
        }
    }
    let t = evaluate(&ema, &config, 50, mode, true);
    println!("TRAINSEEDS success {:.3} strict {:.3} contact {:.3}", t.0, t.1, t.3);
    println!("END {} steps {:.0} s loss {lossavg:.4} drivers {drivers:?} ends {outcomes:?}: success {:.3} strict {:.3} out {:.3} contact {:.3} compl {:.3} len {:.0}", steps, begun.elapsed().as_secs_f32(), e.0, e.1, e.2, e.3, e.4, e.5);
}
