//! The controller process: a command for every tick, whatever happens.

mod handover;

use std::process::ExitCode;
use std::time::Duration;

use clap::Parser;
use controller::ports::Ports;
use controller::{Controller, Inputs, Intent, PolicySlot, Release, Slot, Slots};
use runtime::{Arguments, Contest, Deadline, Member, Pulse, SetUpError, Skipped, Tick, exit_code};
use shm_config::message::{
    Advice, HealthState, Measure, Message, Observation, Part, Plan, Refusal, Step, Takeover, Timing,
};
use shm_config::services::{PLAN, Process, TAKEOVER};
use shm_config::time::monotonic;
use shm_config::{Instant, PlanTurns, RunGrid, config::Config};

use handover::Handover;

/// Answers every observation with a command, and records who drove and why
#[derive(Parser)]
#[command(name = "vlaps-controller", version)]
struct Cli {
    #[command(flatten)]
    arguments: Arguments,
}

/// How long the controller sleeps at most before it says how it does.
const NAP: Duration = Duration::from_millis(20);
/// A car slower than this stands, m/s.
const STANDING_MPS: f64 = 0.05;
/// How long an orderly stop may brake before it gives up, ns.
const STOP_NS: u64 = 5_000_000_000;

fn main() -> ExitCode {
    exit_code(Process::Controller, drive(&Cli::parse().arguments))
}

/// Waits for what a tick needs, never longer than its deadline.
struct Waiting {
    grid: RunGrid,
    slots: Slots,
    turns: PlanTurns,
    lockstep: bool,
    asks_gate: bool,
    period_ns: u64,
    plan_wait_ns: u64,
    plan_age_ns: u64,
    takeover_age_ns: u64,
    lockstep_wait_ns: u64,
    /// A peer that let a wait run out is not waited for until it speaks again.
    planner_silent: bool,
    gate_silent: bool,
    stepped: Option<u64>,
    /// World and tick answered last. What a world publishes between two ticks
    /// carries the number of the first.
    answered: Option<(u32, u64)>,
}

impl Waiting {
    fn new(config: &Config) -> Self {
        let period_ns = config.run.period_ns();
        let share = |share: f64| (period_ns as f64 * share) as u64;
        Self {
            grid: RunGrid::of(config),
            slots: Slots::new(period_ns, share(config.limits.observation_wait)),
            turns: PlanTurns::every(config.plan_ticks()),
            lockstep: config.run.is_lockstep(),
            asks_gate: config.gate.has_process(),
            period_ns,
            plan_wait_ns: share(config.limits.plan_wait),
            plan_age_ns: config.age_limit_ns(PLAN.row.age_limit),
            takeover_age_ns: config.age_limit_ns(TAKEOVER.row.age_limit),
            lockstep_wait_ns: config.peer_wait_ns(),
            planner_silent: false,
            gate_silent: false,
            stepped: None,
            answered: None,
        }
    }

    /// Sleeps until a new observation or the grid asks for a tick; `None` when
    /// the time given has passed without either.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn slot(&mut self, ports: &mut Ports, inputs: &mut Inputs) -> Option<Slot> {
        let grid = self.grid;
        // What is refused at the door is given no tick: the clock is read after the
        // message came, else it would be from the future.
        let mut admitted = Instant::default();
        let door = |observation: &Observation| {
            let at = monotonic();
            grid.admit(observation, at).inspect(|()| admitted = at)
        };
        let newest = ports.observations.newest(door);
        let now = monotonic();
        if let Some(observation) = newest {
            let scheduled = Instant(observation.scheduled_ns);
            let is_new = self.answered != Some(origin(&observation));
            let slot = match (self.lockstep, is_new) {
                (true, true) => Some(Slot {
                    scheduled,
                    due: scheduled,
                    release: Release::Observation,
                    skipped: 0,
                }),
                (true, false) => None,
                (false, _) => self.slots.on_observation(scheduled, now),
            };
            // In lockstep nobody looks between two ticks: runs repeat.
            if is_new || !self.lockstep {
                inputs.observation = Some(observation);
                inputs.admitted.observation_ns = admitted.0;
            }
            if slot.is_some() {
                return slot;
            }
        }
        let nap = match self.slots.deadline() {
            Some(deadline) if now >= deadline => return self.slots.on_timeout(now),
            Some(deadline) => NAP.min(Duration::from_nanos(deadline.since_ns(now))),
            None => NAP,
        };
        ports.bell.wait(nap);
        None
    }

    fn clock(&self, inputs: &Inputs) -> RunClock {
        match (self.lockstep, &inputs.observation) {
            (true, Some(observation)) => RunClock::Stands(observation.header.taken()),
            _ => RunClock::Machine,
        }
    }

    /// Waits for the plan of the new observation where the planner makes one, and
    /// in lockstep for the gate to have seen the step before.
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn peers(&mut self, ports: &mut Ports, inputs: &mut Inputs, slot: &Slot, pulse: &mut Pulse) {
        let tick = inputs
            .observation
            .map(|observation| observation.header.tick);
        let turns = &mut self.turns;
        let is_due = inputs
            .observation
            .is_some_and(|observation| turns.take(&observation.header));
        let begun = monotonic();
        let until = match self.lockstep {
            true => begun.after_ns(self.lockstep_wait_ns),
            false => slot.scheduled.after_ns(self.plan_wait_ns),
        };
        let clock = self.clock(inputs);
        let episode = inputs.observation.map(|o| o.header.episode);
        let plan_age_ns = self.plan_age_ns;
        loop {
            let at = &mut inputs.admitted;
            let plan_door = |plan: &Plan| {
                let now = clock.now();
                admit_plan(plan, now, plan_age_ns, episode).inspect(|()| at.plan_ns = now.0)
            };
            if ports.plans.newest_into(&mut inputs.plan, plan_door) {
                self.planner_silent = false;
            }
            // Advice has its own expiry; its age says nothing.
            let advice_door = |advice: &Advice| {
                let now = clock.now();
                advice
                    .admit(now, u64::MAX)
                    .inspect(|()| at.advice_ns = now.0)
            };
            if ports.advices.newest_into(&mut inputs.advice, advice_door) {
                self.gate_silent = false;
            }
            let planned =
                self.planner_silent || !is_due || inputs.plan.map(|plan| plan.header.tick) == tick;
            let advised = !self.lockstep
                || !self.asks_gate
                || self.gate_silent
                || self.stepped.is_none()
                || inputs.advice.map(|advice| advice.header.tick) >= self.stepped;
            let now = monotonic();
            if planned && advised {
                return;
            }
            if now >= until {
                self.planner_silent = self.lockstep && !planned;
                self.gate_silent = !advised;
                return;
            }
            // A model may think for longer than a silent process is let live.
            if self.lockstep {
                pulse.beat(now);
            }
            // A ring that got lost costs a nap, not the whole wait.
            let left = Duration::from_nanos(until.since_ns(now));
            ports.bell.wait(NAP.min(left));
        }
    }
}

/// The run's clock within one tick.
#[derive(Clone, Copy)]
enum RunClock {
    /// The machine's.
    Machine,
    /// In lockstep, that of the tick's observation.
    Stands(Instant),
}

impl RunClock {
    #[allow(clippy::disallowed_methods)] // the process entry point reads the clock
    fn now(self) -> Instant {
        match self {
            Self::Machine => monotonic(),
            Self::Stands(now) => now,
        }
    }
}

/// The door for plans: also of the episode that is driven, where there is one.
fn admit_plan(
    plan: &Plan,
    now: Instant,
    limit_ns: u64,
    episode: Option<u32>,
) -> Result<(), Refusal> {
    plan.admit(now, limit_ns)?;
    match episode {
        Some(expected) if expected != plan.header.episode => Err(Refusal::Episode {
            episode: plan.header.episode,
            expected,
        }),
        _ => Ok(()),
    }
}

/// Which world said it, and of which tick.
fn origin(observation: &Observation) -> (u32, u64) {
    (observation.header.producer, observation.header.tick)
}

#[allow(clippy::disallowed_methods)] // a process entry point reads the clock
fn drive(arguments: &Arguments) -> Result<(), SetUpError> {
    let mut member = Member::join(Process::Controller, arguments)?;
    let mut ports = Ports::open(&member.wire)?;
    let mut pulse = Pulse::start(&member)?;
    let mut controller = Controller::new(member.config.clone(), PolicySlot::new(None));
    let mut handover = Handover::open(&member, handover::start(&member)?)?;
    handover.begin(&mut controller, &member, &mut pulse)?;
    let mut waiting = Waiting::new(&member.config);
    member.claim_rights();
    pulse.set_rights(&member.rights);
    pulse.enter(HealthState::Ready, monotonic());
    let mut inputs = Inputs::default();
    let mut contest = Contest::default();
    let mut counted_refused = 0;
    let mut stop_until = None;
    let mut seen = monotonic();
    let blind_ns = member.config.limits.observation_age_ns();
    loop {
        let now = monotonic();
        if member.is_stopping() && stop_until.is_none() {
            stop_until = Some(now.after_ns(STOP_NS));
            pulse.health.state = HealthState::Stopping.code();
        }
        pulse.beat(now);
        ports.update_connections();
        handover.look(&mut controller);
        // Nobody is left to brake when no world has spoken for so long.
        let alone = now.since_ns(seen) > blind_ns;
        if stop_until.is_some_and(|until| now >= until || alone) {
            break;
        }
        let Some(slot) = waiting.slot(&mut ports, &mut inputs) else {
            continue;
        };
        if inputs.observation.is_some() {
            seen = now;
        }
        let intent = match stop_until {
            Some(_) => Intent::Stop,
            None if contest.look(&member.wire, now) => Intent::Contested,
            None => Intent::Drive,
        };
        let refused = member.wire.refused().total();
        inputs.refused = refused - counted_refused;
        counted_refused = refused;
        handover.await_first_word(&mut controller, &member, &mut pulse, &ports.bell);
        let stands = tick(
            &mut controller,
            &mut ports,
            &mut waiting,
            &mut pulse,
            &mut inputs,
            (slot, intent),
        );
        if intent == Intent::Stop && stands {
            break;
        }
        pulse.count_refused(&member.wire);
        handover.after_tick(&mut controller);
        handover.await_learner(&mut controller, &member, &mut pulse, &ports.bell);
    }
    pulse.enter(HealthState::Finished, monotonic());
    Ok(())
}

/// Counts how old the inputs of an answered observation were. Where the world is
/// silent, steps say *blind*; how long it was is not the age of an answer.
fn count_ages(step: &Step, timing: &mut Timing) {
    let ages = [
        (Measure::ObservationAge, step.observation_age_ns),
        (Measure::PlanAge, step.plan_age_ns),
        (Measure::AdviceAge, step.advice_age_ns),
    ];
    for (measure, age_ns) in ages {
        // The greatest number stands for "there never was one".
        if age_ns != u64::MAX {
            timing.of_mut(measure).record(age_ns);
        }
    }
}

/// One tick: wait for the plan, decide, command, record. Returns whether the
/// car stands, or nobody can say.
#[allow(clippy::disallowed_methods)] // the process entry point reads the clock
fn tick(
    controller: &mut Controller,
    ports: &mut Ports,
    waiting: &mut Waiting,
    pulse: &mut Pulse,
    inputs: &mut Inputs,
    (slot, intent): (Slot, Intent),
) -> bool {
    let started = monotonic();
    pulse.begin(started);
    let released_ns = inputs.observation.map_or(0, |o| o.released_ns);
    let event = match (slot.release, &inputs.observation) {
        (Release::Observation, Some(observation)) => observation.published(),
        (Release::Observation | Release::TimeOut, _) => slot.due,
    };
    waiting.peers(ports, inputs, &slot, pulse);
    let clock = waiting.clock(inputs);
    let takeover_age_ns = waiting.takeover_age_ns;
    let at = &mut inputs.admitted;
    let takeover_door = |takeover: &Takeover| {
        let now = clock.now();
        let admitted = takeover.admit(now, takeover_age_ns);
        admitted.inspect(|()| at.takeover_ns = now.0)
    };
    inputs.takeover = ports.takeovers.newest(takeover_door);
    let planned = monotonic();
    pulse.end(Part::Wait, planned);
    let now = match clock {
        RunClock::Machine => planned,
        RunClock::Stands(now) => now,
    };
    // What is refused at the door must not number the tick, nor what came after the
    // tick of its own instant: that has its number.
    let is_admitted = controller.admit(inputs, now);
    let seen = inputs.observation.as_ref();
    let seen = seen.filter(|o| is_admitted && o.scheduled_ns == slot.scheduled.0);
    let seen = seen.map(origin);
    let is_answer = seen.is_some() && seen != waiting.answered;
    let tick = match seen {
        Some((_, tick)) if is_answer => {
            waiting.answered = seen;
            tick
        }
        // A foreign observation may have been of the last tick there is.
        _ => {
            let last = controller.step().header.tick;
            last.saturating_add(1 + slot.skipped)
        }
    };
    controller.decide(tick, now, intent);
    *inputs = Inputs::default();
    let decided = monotonic();
    pulse.end(Part::Decide, decided);
    let due_by = slot.scheduled.after_ns(waiting.period_ns);
    let sends = controller.complete(slot.scheduled, decided);
    if sends {
        ports.commands.send(&mut controller.step_mut().command);
    }
    let commanded = monotonic();
    controller.propose_in_shadow();
    let step = controller.step_mut();
    // The account is on the run's clock, as those of planner and world are. A world
    // that was restarted in lockstep begins its clock anew; the account goes on.
    let next_due = Instant(pulse.health.next_scheduled_ns);
    let (due, unanswered) = match (waiting.lockstep, seen) {
        (false, _) => (slot.scheduled, slot.skipped),
        (true, None) => (next_due, 0),
        (true, Some(_)) if pulse.health.ticks == 0 => (now, 0),
        (true, Some(_)) => (
            now.max(next_due),
            now.since_ns(next_due) / waiting.period_ns,
        ),
    };
    step.skipped += unanswered;
    step.timings.released_ns = released_ns;
    step.timings.started_ns = started.0;
    step.timings.planned_ns = planned.0;
    step.timings.commanded_ns = commanded.0;
    ports.steps.send(step);
    waiting.stepped = Some(tick);

    let done = monotonic();
    pulse.end(Part::Send, done);
    pulse.count_tick(Tick {
        due: slot.due,
        released: Some(event),
        begun: started,
        done,
    });
    let skipped = Skipped {
        newest: Instant(slot.scheduled.0.saturating_sub(waiting.period_ns)),
        period_ns: waiting.period_ns,
        count: slot.skipped,
    };
    pulse.record_skipped(skipped, started);
    if !waiting.lockstep {
        pulse.note_deadline(Deadline {
            tick,
            deadline: due_by,
            done,
            skipped: slot.skipped,
            period_ns: waiting.period_ns,
        });
    }
    if released_ns > 0 && sends {
        let response_ns = commanded.0.saturating_sub(released_ns);
        pulse.timing.response.record(response_ns);
    }
    if is_answer {
        count_ages(step, &mut pulse.timing);
    }
    let health = &mut pulse.health;
    health.header.tick = tick;
    health.skipped = step.skipped;
    health.late += u64::from(commanded > due_by);
    if health.ticks == 1 {
        health.first_scheduled_ns = due.0;
    }
    health.next_scheduled_ns = due.after_ns(waiting.period_ns).0;
    if intent != Intent::Stop {
        health.state = HealthState::Running.code();
    }
    let ego = &step.observation.ego;
    let blind = step.observation_age_ns == u64::MAX;
    blind || ego.speed_mps.abs() < STANDING_MPS
}
