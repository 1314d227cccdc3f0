//! No tick of planner or controller allocates: 10,000 ticks that really
//! planned, inferred, judged and drove, ports included, with new weights adopted,
//! tried in shadow and promoted meanwhile.

use allocation_counter::measure;
use controller::{
    Begin, Controller, Exchange, Hand, Inputs, Intent, Look, NativePolicy, News, Offer, PolicySlot,
};
use planner::{PlannerConfig, RrtStar};
use policy::{Activation, Layer, Mlp};
use shm_config::config::Config;
use shm_config::message::{
    Advice, Command, Driver, FEATURES, Observation, Plan, PlanOutcome, Preference, Roster, Step,
    Takeover, Verdict,
};
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{ADVICE, COMMAND, OBSERVATION, PLAN, Process, STEP, TAKEOVER};
use shm_config::wire::{Publisher, Subscriber, Wire};
use shm_config::{Instant, Message};
use sim::{World, WorldConfig};

const TICKS: u64 = 10_000;
/// Ticks in which ports may still connect to each other.
const WARM_UP: u64 = 20;
/// New weights come once in so many.
const SWAP_TICKS: u64 = 500;
const PERIOD_NS: u64 = 100_000_000;

/// Keeps its lane by the features alone, heading and offset, at 5 m/s: a net of
/// the experiment's size whose first three hidden numbers are those features.
fn lane_keeper(version: u64) -> NativePolicy {
    let layer = |inputs: usize, outputs: usize, activation| Layer {
        weights: vec![0.0; inputs * outputs],
        bias: vec![0.0; outputs],
        inputs,
        outputs,
        activation,
    };
    let mut see = layer(FEATURES, 256, Activation::Relu);
    for (hidden, feature) in [2, 8, 3].into_iter().enumerate() {
        see.weights[hidden * FEATURES + feature] = 1.0;
    }
    let mut keep = layer(256, 256, Activation::Relu);
    for hidden in 0..3 {
        keep.weights[hidden * 256 + hidden] = 1.0;
    }
    let mut act = layer(256, 2, Activation::None);
    act.weights[..2].copy_from_slice(&[1.6, 0.675]);
    act.weights[256 + 2] = -6.75;
    act.bias = vec![-1.1375, 0.3 * (5.0 + 1.0 / 3.6)];
    let mlp = Mlp::new(vec![see, keep, act]).expect("layers that fit");
    NativePolicy::new(mlp, version, &[version as u8; 32])
}

struct Ports {
    observation_out: Publisher<Observation>,
    planner_in: Subscriber<Observation>,
    controller_in: Subscriber<Observation>,
    plan_out: Publisher<Plan>,
    plan_in: Subscriber<Plan>,
    advice_out: Publisher<Advice>,
    advice_in: Subscriber<Advice>,
    takeover_out: Publisher<Takeover>,
    takeover_in: Subscriber<Takeover>,
    command_out: Publisher<Command>,
    command_in: Subscriber<Command>,
    step_out: Publisher<Step>,
    _step_in: Subscriber<Step>,
}

impl Ports {
    fn open(wire: &Wire) -> Self {
        let failed = "shared memory";
        Self {
            observation_out: wire.publisher(OBSERVATION).expect(failed),
            planner_in: wire.subscriber(OBSERVATION).expect(failed),
            controller_in: wire.subscriber(OBSERVATION).expect(failed),
            plan_out: wire.publisher(PLAN).expect(failed),
            plan_in: wire.subscriber(PLAN).expect(failed),
            advice_out: wire.publisher(ADVICE).expect(failed),
            advice_in: wire.subscriber(ADVICE).expect(failed),
            takeover_out: wire.publisher(TAKEOVER).expect(failed),
            takeover_in: wire.subscriber(TAKEOVER).expect(failed),
            command_out: wire.publisher(COMMAND).expect(failed),
            command_in: wire.subscriber(COMMAND).expect(failed),
            step_out: wire.publisher(STEP).expect(failed),
            _step_in: wire.subscriber(STEP).expect(failed),
        }
    }
}

impl Ports {
    /// What the processes do between ticks.
    fn tend(&mut self) {
        self.plan_out.tend();
        self.command_out.tend();
        self.step_out.tend();
    }
}

/// What the ticks did, so that the count of zero means something.
#[derive(Debug, Default)]
struct Done {
    planned: u64,
    judged: u64,
    expert: u64,
    policy: u64,
    adopted: u64,
    promoted: u64,
    version: u64,
    metres: f64,
}

fn planner_tick(ports: &mut Ports, planner: &mut RrtStar, plan: &mut Plan, now: Instant) {
    let observation = ports
        .planner_in
        .newest(Message::check)
        .expect("an observation");
    assert!(observation.admit(now, PERIOD_NS).is_ok());
    planner.plan(&observation, plan);
    ports.plan_out.send(plan);
}

fn controller_tick(ports: &mut Ports, controller: &mut Controller, tick: u64, now: Instant) {
    let inputs = Inputs {
        observation: ports.controller_in.newest(Message::check),
        plan: ports.plan_in.newest(Message::check),
        advice: ports.advice_in.newest(Message::check),
        takeover: ports.takeover_in.newest(Message::check),
        ..Inputs::default()
    };
    controller.tick(&inputs, tick, now, Intent::Drive);
    let step = controller.step_mut();
    ports.command_out.send(&mut step.command);
    controller.propose_in_shadow();
    ports.step_out.send(controller.step_mut());
}

#[test]
fn ten_thousand_ticks_allocate_nothing() {
    let name: RunName = format!("t{}-alloc", std::process::id())
        .parse()
        .expect("a name");
    let paths = RunPaths::new(name.clone());
    let wire = Wire::join(&name, Process::Controller).expect("shared memory");
    // As in a run: the ports look at who sent each message.
    let mut roster = Roster::default();
    for process in Process::ALL {
        roster.set(*process, Some(std::process::id()));
    }
    wire.trust(&roster);
    let mut ports = Ports::open(&wire);
    let mut world = World::new(WorldConfig::default()).expect("a world");
    let mut planner = RrtStar::new(PlannerConfig::default()).expect("a planner");
    let policy = PolicySlot::new(Some(Box::new(lane_keeper(1))));
    let (exchange, mut hand) = (Exchange::default(), Hand::default());
    let mut controller = Controller::new(Config::default(), policy);
    let (mut observation, mut plan) = (Box::<Observation>::default(), Box::<Plan>::default());
    let (mut done, mut seed) = (Done::default(), 100);
    let mut allocations = 0;
    world.reset(seed).expect("a map");

    let control = measure(|| drop(std::hint::black_box(Vec::<u8>::with_capacity(100))));
    assert_eq!(control.count_total, 1, "the counter counts");

    for tick in 0..TICKS + WARM_UP {
        let now = Instant((tick + 1) * PERIOD_NS);
        // A car that the judge holds before an obstacle proves nothing more.
        if world.last_step().has_ended() || world.ticks() >= 400 {
            done.metres += world.driven_m();
            seed += 1;
            world.reset(seed).expect("a map");
        }
        world.observe(&mut observation);
        observation.header.tick = tick;
        observation.header.taken_ns = now.0;
        observation.header.episode = seed as u32;
        ports.observation_out.send(&mut observation);
        let turn = [Preference::Policy, Preference::Expert][(tick / 50 % 2) as usize];
        ports.advice_out.send(&mut Advice {
            preference: turn.code(),
            answers: 1,
            holds_until_ns: u64::MAX,
            ..Advice::default()
        });
        ports.takeover_out.send(&mut Takeover {
            header: observation.header,
            ..Takeover::default()
        });

        // What the loader's thread does: an offer now and then.
        if tick % SWAP_TICKS == SWAP_TICKS / 2 {
            exchange.desk.lock().expect("a desk").offer = Some(Offer {
                policy: Box::new(lane_keeper(2 + tick / SWAP_TICKS)),
                begin: Begin::Shadow,
            });
        }

        let taken = measure(|| {
            let Look::Seen(offer) = hand.look(&exchange) else {
                panic!("nobody holds the desk");
            };
            if let Some(offer) = offer {
                controller.adopt(offer, tick, &mut hand);
            }
            planner_tick(&mut ports, &mut planner, &mut plan, now);
            controller_tick(&mut ports, &mut controller, tick, now);
            controller.try_policies(&mut hand);
        });
        // Sending gives back the handle that was borrowed between the ticks: a
        // free of 48 bytes to the thread's own cache, which takes no lock.
        if tick >= WARM_UP {
            allocations += taken.count_total;
        }
        let mut desk = exchange.desk.lock().expect("a desk");
        desk.returned = Default::default();
        for news in std::mem::take(&mut desk.news).into_iter().flatten() {
            done.adopted += u64::from(matches!(news, News::Adopted { .. }));
            done.promoted += u64::from(matches!(news, News::Promoted { .. }));
        }
        drop(desk);
        ports.tend();

        let step = controller.step();
        done.planned += u64::from(step.plan.outcome() != PlanOutcome::Blocked);
        let judged = [step.expert_assessment, step.policy_assessment]
            .map(|assessment| assessment.verdict() != Verdict::Absent);
        done.judged += u64::from(judged == [true, true]);
        done.version = step.weights_version;
        done.expert += u64::from(step.driver() == Driver::Expert);
        done.policy += u64::from(step.driver() == Driver::Policy);
        let command = ports.command_in.newest(Message::check).expect("a command");
        world.step(command.action());
    }
    drop(ports);
    drop(wire);
    let _ = paths.clean_if_dead();
    paths.remove_dir();
    assert!(
        done.planned > 9_000 && done.judged > 9_000 && done.expert > 3_000 && done.policy > 3_000,
        "{done:?}"
    );
    let swaps = TICKS / SWAP_TICKS;
    assert_eq!((done.adopted, done.promoted), (swaps, swaps), "{done:?}");
    assert_eq!(
        done.version,
        swaps + 1,
        "the last one is in charge: {done:?}"
    );
    assert!(done.metres > 1_000.0, "{done:?}");
    assert_eq!(
        allocations, 0,
        "allocations and reallocations in {TICKS} ticks"
    );
}
