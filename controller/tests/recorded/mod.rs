//! An in-test world that drives the real controller and records its steps: drawn
//! takeovers, advice, policies and plans; inputs that are missing, late, from the
//! future or not finite; restarts, and a clock that jitters.

use std::collections::BTreeSet;

use controller::{
    Candidate, Controller, Inputs, Intent, Mailbox, NativePolicy, Policy, PolicySlot, StartStage,
    TickEnd,
};
use policy::drawn::Spread;
use shm_config::Instant;
use shm_config::config::Config;
use shm_config::draw::Draw;
use shm_config::message::{
    Advice, Bend, Observation, Plan, PlanOutcome, PlannedAction, Step, Takeover, Waypoint,
};
use vehicle::{Action, State, step};

const MS: u64 = 1_000_000;
const PERIOD_NS: u64 = 100 * MS;

/// A net of random weights: another driver for each version.
pub fn net(version: u64) -> NativePolicy {
    let spread = Spread {
        weights: [0.1, 0.5],
        bias_min: -0.3,
        bias_max: 0.3,
    };
    let mlp = policy::drawn::net(version, spread).expect("finite weights");
    let mut sha256 = [0; 32];
    sha256[..8].copy_from_slice(&version.to_be_bytes());
    NativePolicy::new(mlp, version, &sha256)
}

/// A net that now and then has no answer, or one that is not finite.
struct Faulty {
    net: NativePolicy,
    draw: Draw,
}

impl Policy for Faulty {
    fn infer(&mut self, features: &[f32]) -> Option<Action> {
        match self.draw.below(60) {
            0 => None,
            1 => Some(Action {
                steer: f64::NAN,
                pedal: 0.0,
            }),
            _ => self.net.infer(features),
        }
    }
    fn version(&self) -> u64 {
        self.net.version()
    }
    fn hash(&self) -> u64 {
        self.net.hash()
    }
}

/// World, driver, gate and loader in one, around the controller.
pub struct Recording {
    config: Config,
    controller: Controller,
    end: TickEnd,
    mailbox: Mailbox,
    draw: Draw,
    car: State,
    episode: u32,
    sequence: u64,
    producer: u32,
    tick: u64,
    version: u64,
    taking_over: bool,
    intent: Intent,
    faults: bool,
}

impl Recording {
    pub fn new(config: Config, seed: u64) -> Self {
        Self {
            controller: Controller::new(config.clone(), PolicySlot::new(None)),
            config,
            end: TickEnd::default(),
            mailbox: Mailbox::default(),
            draw: Draw::new(seed),
            car: State::at_origin(5.0),
            episode: 0,
            sequence: 0,
            producer: 100,
            tick: 100,
            version: 0,
            taking_over: false,
            intent: Intent::Drive,
            faults: true,
        }
    }

    /// Without policies that fail: what they propose can be asked again.
    pub fn without_policy_faults(self) -> Self {
        Self {
            faults: false,
            ..self
        }
    }

    /// Drives one tick as the process does, and gives the step that it publishes.
    pub fn step(&mut self) -> Step {
        self.between_ticks();
        let scheduled = Instant(self.tick * PERIOD_NS);
        // A tick begins some milliseconds after its instant, now and then much later.
        let late_ns = match self.draw.below(200) {
            0 => self.draw.below(900 * MS),
            _ => self.draw.below(20 * MS),
        };
        let now = scheduled.after_ns(late_ns);
        let inputs = self.inputs(scheduled, now);
        self.controller.admit(&inputs, now);
        self.controller.decide(self.tick, now, self.intent);
        let decided_ns = match self.draw.below(100) {
            0 => 150 * MS,
            _ => self.draw.below(3 * MS),
        };
        let sends = self
            .controller
            .complete(scheduled, now.after_ns(decided_ns));
        self.sequence += 1;
        let (sequence, producer) = (self.sequence, self.producer);
        let command = &mut self.controller.step_mut().command;
        if sends {
            (command.header.sequence, command.header.producer) = (sequence, producer);
        }
        let action = command.action();
        self.controller.propose_in_shadow();
        let step = self.controller.step_mut();
        step.skipped += late_ns / PERIOD_NS;
        (step.header.sequence, step.header.producer) = (sequence, producer);
        step.timings.started_ns = now.0 - late_ns / 2;
        step.timings.commanded_ns = now.0 + decided_ns;
        let recorded = *step;
        self.controller.run_canary(&mut self.end);
        let control = action.control(&self.config.vehicle);
        self.car = vehicle_step(&self.config, &self.car, control);
        self.tick += 1 + late_ns / PERIOD_NS;
        recorded
    }

    /// Restarts, new weights, a new episode, the driver's grip, the run's end.
    fn between_ticks(&mut self) {
        let _ = self.end.exchange(&self.mailbox);
        {
            let mut contents = self.mailbox.contents.lock().expect("a mailbox");
            contents.returned = Default::default();
            contents.events = Default::default();
        }
        if self.draw.one_in(700) {
            let config = self.config.clone();
            self.controller = Controller::new(config, PolicySlot::new(None));
            self.end = TickEnd::default();
            (self.sequence, self.producer) = (0, self.producer + 1);
        }
        if self.draw.one_in(90) {
            self.version += 1;
            let net = net(self.version);
            let draw = Draw::new(self.version);
            let policy: Box<dyn Policy> = match self.faults {
                true => Box::new(Faulty { net, draw }),
                false => Box::new(net),
            };
            let start = match self.draw.one_in(3) {
                true => StartStage::Settled,
                false => StartStage::Shadow,
            };
            let candidate = Candidate { policy, start };
            self.controller.adopt(candidate, self.tick, &mut self.end);
        }
        if self.draw.one_in(150) {
            self.episode += 1;
            self.car = State::at_origin(self.draw.within(0.0, 12.0));
        }
        if self.draw.one_in(40) {
            self.taking_over = !self.taking_over;
        }
        self.intent = match (self.intent, self.draw.below(300)) {
            (Intent::Drive, 0) => Intent::Stop,
            (Intent::Drive, 1) => Intent::Contested,
            (Intent::Drive, _) => Intent::Drive,
            (other, 0..100) => other,
            (_, _) => Intent::Drive,
        };
    }

    fn inputs(&mut self, scheduled: Instant, now: Instant) -> Inputs {
        let mut inputs = Inputs {
            refused: self.draw.below(40) / 38,
            ..Inputs::default()
        };
        inputs.admitted.observation_ns = scheduled.0 + self.draw.below(MS);
        inputs.admitted.plan_ns = now.0 - self.draw.below(MS);
        inputs.admitted.advice_ns = now.0 - self.draw.below(MS);
        inputs.admitted.takeover_ns = now.0;
        if !self.draw.one_in(25) {
            inputs.observation = self.observation(scheduled).into();
        }
        if !self.draw.one_in(8) {
            inputs.plan = self.plan(scheduled).into();
        }
        if self.draw.one_in(4) {
            inputs.advice = self.advice(now).into();
        }
        if self.draw.one_in(2) {
            inputs.takeover = self.takeover(now).into();
        }
        inputs
    }

    /// When a message was taken: mostly at `at`; or too long ago, or in the future.
    fn taken(&mut self, at: Instant) -> u64 {
        match self.draw.below(80) {
            0 => at.0.saturating_sub(600 * MS),
            1 => at.0 + 3_000 * MS,
            _ => at.0.saturating_sub(self.draw.below(5 * MS)),
        }
    }

    /// A road of 10.5 m with now and then something on it, or a curve.
    fn observation(&mut self, scheduled: Instant) -> Observation {
        let y_m = self.car.position.y.clamp(-8.0, 8.0);
        let mut seen = Observation {
            beam_count: 240,
            lidar_max_m: 50.0,
            scheduled_ns: scheduled.0,
            ..Observation::default()
        };
        seen.header.tick = self.tick;
        seen.header.taken_ns = self.taken(scheduled);
        seen.header.episode = self.episode;
        seen.ego.x_world_m = self.car.position.x;
        seen.ego.y_world_m = self.car.position.y;
        seen.ego.heading_world_rad = self.car.heading_rad;
        seen.ego.speed_mps = self.car.speed_mps;
        (seen.road.left_m, seen.road.right_m) = (5.25 - y_m, 5.25 + y_m);
        seen.road.heading_rad = self.car.heading_rad;
        for checkpoint in &mut seen.checkpoints {
            checkpoint.x_body_m = self.draw.within(10.0, 40.0);
        }
        if self.draw.one_in(5) {
            let checkpoint = &mut seen.checkpoints[0];
            checkpoint.bend = Bend::Left.code();
            checkpoint.bend_radius_m = self.draw.within(15.0, 60.0);
            checkpoint.bend_angle_rad = 1.0;
        }
        for range_m in &mut seen.ranges_m[..240] {
            *range_m = 50.0;
        }
        if self.draw.one_in(8) {
            let first = self.draw.below(230) as usize;
            let range_m = self.draw.within(2.5, 20.0) as f32;
            seen.ranges_m[first..first + 10].fill(range_m);
        }
        if self.draw.one_in(80) {
            seen.ego.speed_mps = f64::NAN;
        }
        seen
    }

    /// A path along the road, a list of actions, or none.
    fn plan(&mut self, scheduled: Instant) -> Plan {
        let age_ns = self.draw.below(2) * PERIOD_NS;
        let mut plan = Plan {
            outcome: PlanOutcome::Reached.code(),
            waypoint_count: 8,
            goal_x_body_m: self.draw.within(8.0, 12.0),
            origin_x_world_m: self.car.position.x,
            origin_y_world_m: self.car.position.y,
            origin_heading_world_rad: self.car.heading_rad,
            ..Plan::default()
        };
        plan.header.tick = self.tick;
        plan.header.taken_ns = self.taken(Instant(scheduled.0 - age_ns));
        plan.header.episode = match self.draw.one_in(60) {
            true => self.episode.wrapping_sub(1),
            false => self.episode,
        };
        let left_m = self.draw.within(-0.2, 0.2) - self.car.position.y * 0.05;
        let speed_mps = self.draw.within(0.0, 10.0);
        for (k, waypoint) in plan.waypoints.iter_mut().take(8).enumerate() {
            *waypoint = Waypoint {
                x_body_m: 1.5 * k as f64,
                y_body_m: left_m * k as f64,
                speed_mps,
            };
        }
        match self.draw.below(40) {
            0 => plan.outcome = PlanOutcome::Blocked.code(),
            1 => plan.goal_x_body_m = 45.0,
            2 => plan.waypoint_count = 200,
            3..=5 => {
                (plan.action_count, plan.action_step_s) = (4, 0.1);
                plan.actions[..4].fill(PlannedAction {
                    steer: left_m,
                    pedal: 0.1,
                });
            }
            _ => {}
        }
        plan
    }

    fn advice(&mut self, now: Instant) -> Advice {
        let mut advice = Advice {
            answers: self.draw.below(5),
            question_taken_ns: now.0 - self.draw.below(2_000 * MS),
            holds_until_ns: now.0 + self.draw.below(1_500 * MS),
            preference: self.draw.below(3) as u32,
            ..Advice::default()
        };
        advice.header.taken_ns = now.0;
        if self.draw.one_in(100) {
            advice.preference = 9;
        }
        advice
    }

    fn takeover(&mut self, now: Instant) -> Takeover {
        let mut takeover = Takeover {
            steer: self.draw.within(-1.0, 1.0),
            pedal: self.draw.within(-1.0, 1.0),
            active: u32::from(self.taking_over),
            ..Takeover::default()
        };
        takeover.header.taken_ns = self.taken(now);
        takeover
    }
}

/// The car one tick later.
fn vehicle_step(config: &Config, car: &State, control: vehicle::Control) -> State {
    step(&config.vehicle, car, control, 0.1)
}

/// What the steps of a recording show, as words: what a recording must have in it.
pub fn seen(step: &Step, words: &mut BTreeSet<String>) {
    let mut say = |word: String| words.insert(word);
    if let Some(reason) = step.reason() {
        say(format!("reason {reason}"));
    }
    say(format!("stage {}", step.stage()));
    say(format!("intent {}", step.intent()));
    say(format!("lateness {}", step.lateness));
    for (name, entry) in [
        ("observation", &step.observation_entry),
        ("plan", &step.plan_entry),
        ("advice", &step.advice_entry),
        ("takeover", &step.takeover_entry),
    ] {
        say(format!("{name} {}", entry.admission()));
    }
    if step.before.transfer.is_easing == 1 {
        say("easing".into());
    }
    if step.before.pd.present == 1 {
        say("tracking".into());
    }
    if step.before.has_observation == 0 {
        say("restart".into());
    }
    if step.takeover_used == 1 {
        say("takeover used".into());
    }
    if step.shadow.proposal.present == 1 {
        say("shadow proposal".into());
    }
}
