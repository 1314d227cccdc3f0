//! What the set says, checked as a vehicle would check it: no command beyond its
//! limits, none on old inputs, every tick of the grid accounted for.

use shm_config::Instant;
use shm_config::config::Config;
use shm_config::message::{Command, Driver, Message, Reason, Step};

use super::strangers::trace_in;

/// Descriptions kept of violations; the rest is only counted.
const KEPT: usize = 20;

/// The limits of a run, ns.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// From tick to tick.
    pub period_ns: u64,
    /// Older commands are not obeyed.
    pub command_age_ns: u64,
    /// Older observations are not driven on.
    pub observation_age_ns: u64,
    /// Older plans are not followed.
    pub plan_age_ns: u64,
}

impl Limits {
    /// Of a configuration.
    pub fn of(config: &Config) -> Self {
        Self {
            period_ns: config.run.period_ns(),
            command_age_ns: config.limits.command_age_ns(),
            observation_age_ns: config.limits.observation_age_ns(),
            plan_age_ns: config.plan_age_ns(),
        }
    }

    /// The first instant of the vehicle's grid at which it brakes by itself when no
    /// command comes after the one given at `taken`; the grid has an instant at
    /// `anchor`, before that.
    pub fn own_brake(&self, taken: Instant, anchor: Instant) -> Instant {
        // The first age that is over the limit.
        let expiry = taken.after_ns(self.command_age_ns + 1);
        let passed = expiry.since_ns(anchor).div_ceil(self.period_ns);
        anchor.after_ns(passed * self.period_ns)
    }
}

/// The account of a run, over all restarts of its processes.
#[derive(Debug)]
pub struct Ledger {
    limits: Limits,
    /// The process that lies; what it sends may never be driven on.
    stranger: u32,
    last: Option<Box<Step>>,
    /// Steps read.
    pub steps: u64,
    /// Steps that the reader did not get, by their numbers.
    pub lost: u64,
    /// Ticks that the controller said it skipped.
    pub skipped: u64,
    /// Ticks of the grid without a controller, between two that lived.
    pub unmanned: u64,
    /// Ticks of the grid that are neither step nor skipped nor unmanned.
    pub unaccounted: u64,
    /// Commands that violate a limit.
    pub violations: u64,
    /// The first of them, in words.
    pub words: Vec<String>,
}

impl Ledger {
    /// Nothing has been read; `stranger` is the process that lies.
    pub fn new(limits: Limits, stranger: u32) -> Self {
        Self {
            limits,
            stranger,
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

    /// Takes a step in; whether its command is safe: within its limits, and the
    /// brake or an answer to inputs that are young enough.
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

    /// Takes a command in as the vehicle gets it.
    pub fn command(&mut self, command: &Command, now: Instant) {
        if let Err(refusal) = command.admit(now, u64::MAX) {
            self.note(format!("tick {}: command: {refusal}", command.header.tick));
        }
    }

    /// The world said how old the oldest command is that it obeyed.
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
        if let Some(trace) = trace_in(step, self.stranger) {
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
            self.violated(step, &format!("driven on an observation {age_ns} ns old"));
        }
        let needs_plan = step.driver() == Driver::Expert && step.reason() != Some(Reason::Takeover);
        let age_ns = now.since_ns(step.plan.header.taken());
        if needs_plan && age_ns > self.limits.plan_age_ns {
            self.violated(step, &format!("driven on a plan {age_ns} ns old"));
        }
    }

    /// Order and completeness against the step before.
    fn follow(&mut self, step: &Step) {
        let Some(last) = self.last.take() else {
            return;
        };
        let period_ns = self.limits.period_ns;
        let (from, to) = (last.timings.scheduled_ns, step.timings.scheduled_ns);
        // Another world's grid may be shifted: round to whole periods, as the
        // controller does.
        let passed = (to.saturating_sub(from) + period_ns / 2) / period_ns;
        let same_controller = last.header.producer == step.header.producer;
        if !same_controller {
            self.unmanned += passed.saturating_sub(1);
            return;
        }
        if step.header.sequence <= last.header.sequence {
            self.violated(step, "its number does not follow the one before");
            return;
        }
        let same_world = last.observation.header.producer == step.observation.header.producer;
        if same_world && step.header.tick <= last.header.tick {
            self.violated(step, &format!("its tick follows tick {}", last.header.tick));
        }
        if step.command.header.taken() < last.command.header.taken() {
            self.violated(step, "given before the one before");
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

/// The step was decided on inputs that came after an instant: the set drives,
/// regardless of what it decided.
pub fn is_fresh(step: &Step, after: Instant) -> bool {
    let starved = matches!(
        step.reason(),
        None | Some(Reason::Blind | Reason::Unplanned | Reason::Stopping | Reason::Contested)
    );
    !starved && step.observation.header.taken() > after && step.plan.header.taken() > after
}

#[cfg(test)]
mod tests {
    use super::super::strangers::STRANGE_STEER;
    use super::*;

    const LIMITS: Limits = Limits {
        period_ns: 100,
        command_age_ns: 150,
        observation_age_ns: 250,
        plan_age_ns: 250,
    };

    const STRANGER: u32 = 666;

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
    fn what_is_in_order_is_no_violation_and_every_tick_is_accounted_for() {
        let mut ledger = Ledger::new(LIMITS, STRANGER);
        let mut skipping = step(5);
        // Two ticks of the grid were skipped: numbers 3 and 4 never were.
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
    fn a_tick_that_nobody_owns_up_to_is_seen() {
        let mut ledger = Ledger::new(LIMITS, STRANGER);
        ledger.step(&step(1));
        let mut gap = step(4);
        gap.header.sequence = 2;
        ledger.step(&gap);
        assert_eq!(ledger.unaccounted, 2);
    }

    #[test]
    fn each_limit_is_seen_when_it_is_violated() {
        let spoils: [fn(&mut Step); 11] = [
            |s| s.observation.header.producer = STRANGER,
            |s| s.plan.header.producer = STRANGER,
            |s| s.observation.ego.steer = STRANGE_STEER,
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
            let mut ledger = Ledger::new(LIMITS, STRANGER);
            ledger.step(&step(11));
            let mut bad = step(12);
            spoil(&mut bad);
            assert!(!ledger.step(&bad), "limit {which}");
            assert_eq!(ledger.violations, 1, "limit {which}: {:?}", ledger.words);
        }
        let mut ledger = Ledger::new(LIMITS, STRANGER);
        ledger.obeyed(150);
        assert_eq!(ledger.violations, 0);
        ledger.obeyed(151);
        let mut command = step(1).command;
        command.header.taken_ns = 2_000_000;
        ledger.command(&command, Instant(5));
        assert_eq!(ledger.violations, 2, "an old one obeyed, one of the future");
    }

    #[test]
    fn the_vehicle_brakes_at_its_first_instant_after_the_limit() {
        let brakes = |taken| LIMITS.own_brake(Instant(taken), Instant(300));
        // Taken at 325, 150 old at 475: still obeyed then, so 500.
        assert_eq!(brakes(325), Instant(500));
        assert_eq!(brakes(350), Instant(600));
    }
}
