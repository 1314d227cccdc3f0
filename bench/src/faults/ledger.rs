//! Checks the set's messages as a vehicle would: no command beyond its limits, none on
//! stale inputs, and every tick of the grid accounted for.

use shm_config::Instant;
use shm_config::config::Config;
use shm_config::message::{Command, Driver, Message, Reason, Step};

use super::foreign::forgery_in;

/// Number of violations that are described; all are counted.
const KEPT: usize = 20;

/// Limits of a run, ns.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Tick period.
    pub period_ns: u64,
    /// Commands older than this are not obeyed.
    pub command_age_ns: u64,
    /// Observations older than this are not driven on.
    pub observation_age_ns: u64,
    /// Plans older than this are not followed.
    pub plan_age_ns: u64,
}

impl Limits {
    /// The limits of a configuration.
    pub fn of(config: &Config) -> Self {
        Self {
            period_ns: config.run.period_ns(),
            command_age_ns: config.limits.command_age_ns(),
            observation_age_ns: config.limits.observation_age_ns(),
            plan_age_ns: config.plan_age_ns(),
        }
    }

    /// The first instant of the vehicle's grid at which it brakes by itself if no command
    /// follows the one that was given at `taken`. The grid has an instant at `anchor`, which
    /// is before `taken`.
    pub fn own_brake(&self, taken: Instant, anchor: Instant) -> Instant {
        // The first age beyond the limit.
        let expiry = taken.after_ns(self.command_age_ns + 1);
        let passed = expiry.since_ns(anchor).div_ceil(self.period_ns);
        anchor.after_ns(passed * self.period_ns)
    }
}

/// Counts ticks and violations of a run across all restarts of its processes.
#[derive(Debug)]
pub struct Ledger {
    limits: Limits,
    /// Process id of the forging process; no step may be based on its messages.
    foreign: u32,
    last: Option<Box<Step>>,
    /// Steps read.
    pub steps: u64,
    /// Steps that were not read, by gaps in their numbers.
    pub lost: u64,
    /// Ticks that the controller reported as skipped.
    pub skipped: u64,
    /// Ticks of the grid without a controller, between two controllers.
    pub unmanned: u64,
    /// Ticks of the grid that are neither step, skipped nor without a controller.
    pub unaccounted: u64,
    /// Commands that violate a limit.
    pub violations: u64,
    /// Descriptions of the first violations.
    pub words: Vec<String>,
}

impl Ledger {
    /// An empty ledger; `foreign` is the process id of the forging process.
    pub fn new(limits: Limits, foreign: u32) -> Self {
        Self {
            limits,
            foreign,
            last: None,
            steps: 0,
            lost: 0,
            skipped: 0,
            unmanned: 0,
            unaccounted: 0,
            violations: 0,
            words: Vec::new(),
        }
    }

    /// Counts a step. Returns whether its command is safe: within its limits, and either
    /// braking or based on inputs that are fresh enough.
    pub fn step(&mut self, step: &Step) -> bool {
        self.steps += 1;
        let before = self.violations;
        if let Err(refusal) = step.check() {
            self.violated(step, &refusal.to_string());
        }
        self.check_inputs(step);
        self.follow(step);
        self.last = Some(Box::new(*step));
        before == self.violations
    }

    /// Checks a command as the vehicle receives it.
    pub fn command(&mut self, command: &Command, now: Instant) {
        if let Err(refusal) = command.admit(now, u64::MAX) {
            self.note(format!("tick {}: command: {refusal}", command.header.tick));
        }
    }

    /// Checks the age of the oldest command that the world reports to have obeyed.
    pub fn obeyed(&mut self, oldest_ns: u64) {
        if oldest_ns > self.limits.command_age_ns {
            self.note(format!("the world obeyed a command {oldest_ns} ns old"));
        }
    }

    /// The newest step.
    pub fn newest(&self) -> Option<&Step> {
        self.last.as_deref()
    }

    fn check_inputs(&mut self, step: &Step) {
        if let Some(trace) = forgery_in(step, self.foreign) {
            self.violated(step, trace);
        }
        if step.driver() == Driver::Brake {
            if step.command.pedal != -1.0 {
                self.violated(step, "the brake is not the full brake");
            }
            return;
        }
        let now = step.command.header.taken();
        let age_ns = now.since_ns(step.observation.header.taken());
        if age_ns > self.limits.observation_age_ns {
            self.violated(step, &format!("based on an observation {age_ns} ns old"));
        }
        let needs_plan = step.driver() == Driver::Expert && step.reason() != Some(Reason::Takeover);
        let age_ns = now.since_ns(step.plan.header.taken());
        if needs_plan && age_ns > self.limits.plan_age_ns {
            self.violated(step, &format!("based on a plan {age_ns} ns old"));
        }
    }

    /// Checks order and completeness against the previous step.
    fn follow(&mut self, step: &Step) {
        let Some(last) = self.last.take() else {
            return;
        };
        let period_ns = self.limits.period_ns;
        let (from, to) = (last.timings.scheduled_ns, step.timings.scheduled_ns);
        // The grid of a restarted world may be shifted: round to whole periods, as the
        // controller does.
        let passed = (to.saturating_sub(from) + period_ns / 2) / period_ns;
        let same_controller = last.header.producer == step.header.producer;
        if !same_controller {
            self.unmanned += passed.saturating_sub(1);
            return;
        }
        if step.header.sequence <= last.header.sequence {
            self.violated(step, "its number does not follow the previous one");
            return;
        }
        let same_world = last.observation.header.producer == step.observation.header.producer;
        if same_world && step.header.tick <= last.header.tick {
            self.violated(step, &format!("its tick follows tick {}", last.header.tick));
        }
        if step.command.header.taken() < last.command.header.taken() {
            self.violated(step, "its time is before that of the previous step");
        }
        let ticks = step.header.sequence - last.header.sequence;
        let skipped = step.skipped.saturating_sub(last.skipped);
        self.lost += ticks - 1;
        self.skipped += skipped;
        self.unaccounted += passed.abs_diff(ticks + skipped);
    }

    fn violated(&mut self, step: &Step, what: &str) {
        let (header, driver) = (&step.header, step.driver());
        self.note(format!(
            "tick {} of controller {}, {driver}: {what}",
            header.tick, header.producer
        ));
    }

    fn note(&mut self, words: String) {
        self.violations += 1;
        if self.words.len() < KEPT {
            self.words.push(words);
        }
    }
}

/// Whether the step is based on inputs newer than `after`, which shows that
/// the set drives; a brake counts, too.
pub fn is_fresh(step: &Step, after: Instant) -> bool {
    let starved = matches!(
        step.reason(),
        None | Some(Reason::Blind | Reason::Unplanned | Reason::Stopping | Reason::Contested)
    );
    !starved && step.observation.header.taken() > after && step.plan.header.taken() > after
}

#[cfg(test)]
mod tests {
    use super::super::foreign::FORGED_STEER;
    use super::*;

    const LIMITS: Limits = Limits {
        period_ns: 100,
        command_age_ns: 150,
        observation_age_ns: 250,
        plan_age_ns: 250,
    };

    const FOREIGN: u32 = 666;

    fn step(number: u64) -> Step {
        let mut step = Step::default();
        step.header.sequence = number;
        step.header.tick = number;
        step.header.producer = 7;
        step.timings.scheduled_ns = 100 * number;
        let taken_ns = 100 * number + 20;
        for header in [&mut step.observation.header, &mut step.plan.header] {
            header.taken_ns = taken_ns;
        }
        step.command.header.taken_ns = taken_ns + 5;
        step.command.driver = Driver::Expert.code();
        step.command.reason = Reason::Configured.code();
        step
    }

    #[test]
    fn valid_steps_are_no_violation_and_every_tick_is_accounted_for() {
        let mut ledger = Ledger::new(LIMITS, FOREIGN);
        let mut skipping = step(5);
        // Two ticks of the grid were skipped: steps 3 and 4 do not exist.
        (skipping.header.sequence, skipping.skipped) = (3, 2);
        for step in [step(1), step(2), skipping] {
            assert!(ledger.step(&step), "{:?}", ledger.words);
        }
        assert_eq!((ledger.skipped, ledger.unaccounted, ledger.lost), (2, 0, 0));
        let mut successor = step(9);
        successor.header.producer = 8;
        assert!(ledger.step(&successor));
        assert_eq!((ledger.unmanned, ledger.unaccounted), (3, 0));
    }

    #[test]
    fn an_unaccounted_tick_is_counted() {
        let mut ledger = Ledger::new(LIMITS, FOREIGN);
        ledger.step(&step(1));
        let mut gap = step(4);
        gap.header.sequence = 2;
        ledger.step(&gap);
        assert_eq!(ledger.unaccounted, 2);
    }

    #[test]
    fn each_violated_limit_is_detected() {
        let spoils: [fn(&mut Step); 11] = [
            |s| s.observation.header.producer = FOREIGN,
            |s| s.plan.header.producer = FOREIGN,
            |s| s.observation.ego.steer = FORGED_STEER,
            |s| s.command.steer = f64::NAN,
            |s| s.command.pedal = 1.5,
            |s| s.command.reason = 99,
            |s| s.observation.header.taken_ns -= 260,
            |s| s.plan.header.taken_ns -= 260,
            |s| s.header.tick = 1,
            |s| s.header.sequence = 1,
            |s| (s.command.driver, s.command.pedal) = (Driver::Brake.code(), -0.5),
        ];
        for (which, spoil) in spoils.into_iter().enumerate() {
            let mut ledger = Ledger::new(LIMITS, FOREIGN);
            ledger.step(&step(11));
            let mut bad = step(12);
            spoil(&mut bad);
            assert!(!ledger.step(&bad), "limit {which}");
            assert_eq!(ledger.violations, 1, "limit {which}: {:?}", ledger.words);
        }
        let mut ledger = Ledger::new(LIMITS, FOREIGN);
        ledger.obeyed(150);
        assert_eq!(ledger.violations, 0);
        ledger.obeyed(151);
        let mut command = step(1).command;
        command.header.taken_ns = 2_000_000;
        ledger.command(&command, Instant(5));
        assert_eq!(
            ledger.violations, 2,
            "an old command obeyed, and one of the future"
        );
    }

    #[test]
    fn the_vehicle_brakes_at_its_first_instant_after_the_limit() {
        let brakes = |taken| LIMITS.own_brake(Instant(taken), Instant(300));
        // Taken at 325. At 475 its age is 150: still obeyed. The brake follows at 500.
        assert_eq!(brakes(325), Instant(500));
        assert_eq!(brakes(350), Instant(600));
    }
}
