//! The controller process: one command for every tick, without exception.

mod kept;
mod swap;
mod wait;

use runtime::{
    Contest, Deadline, DueTick, FixedRate, Flow, Member, Release, SetUpError, Telemetry, Tick,
    TickLoop,
};
use shm_config::Instant;
use shm_config::message::{HealthState, Measure, Message, Part, Step, Takeover, Timing};
use shm_config::services::TAKEOVER;

use crate::ports::Ports;
use crate::{Controller, Inputs, Intent, PolicySlot};
use kept::RecorderWait;
use swap::PolicySwap;
use wait::{Begun, RunClock, Waiting, origin};

/// A car slower than this stands, m/s.
const STANDING_MPS: f64 = 0.05;
/// Interval at which learner, loader and recorder are polled, in lockstep, ns: the loader
/// does not wake the controller.
const POLL_NS: u64 = 2_000_000;
/// How long an orderly stop may brake before it ends, ns.
const STOP_NS: u64 = 5_000_000_000;

/// Runs the controller until it is stopped.
///
/// # Errors
/// When shared memory, the configuration or the run's first policy refuses.
pub fn run(member: Member, ports: Ports) -> Result<(), SetUpError> {
    let mut run = TickLoop::start(member)?;
    let mut process = ControllerProcess::open(&mut run, ports)?;
    run.run(&mut process)
}

/// The controller between its ports.
pub struct ControllerProcess {
    ports: Ports,
    controller: Controller,
    swap: PolicySwap,
    recorder: Option<RecorderWait>,
    waiting: Waiting,
    /// In lockstep, the tick that waits for its peers.
    begun: Option<Begun>,
    inputs: Inputs,
    contest: Contest,
    counted_refused: u64,
    takeover_age_ns: u64,
    /// An observation older than this is not driven on, ns.
    blind_ns: u64,
    stop_until: Option<Instant>,
    /// When an observation last released a tick, or a world was waiting for one.
    observed: Instant,
}

impl ControllerProcess {
    /// Allocates everything and waits for the run's first policy.
    ///
    /// # Errors
    /// When shared memory or the policy refuses.
    pub fn open(run: &mut TickLoop, ports: Ports) -> Result<Self, SetUpError> {
        let config = &run.member.config;
        let (takeover_age_ns, blind_ns) = (
            config.age_limit_ns(TAKEOVER.row.age_limit),
            config.limits.observation_age_ns(),
        );
        let waiting = Waiting::new(config);
        let mut controller = Controller::new(config.clone(), PolicySlot::new(None));
        let mut swap = PolicySwap::open(&run.member)?;
        swap.begin(run, &mut controller)?;
        Ok(Self {
            ports,
            controller,
            swap,
            recorder: RecorderWait::open(&run.member)?,
            waiting,
            begun: None,
            inputs: Inputs::default(),
            contest: Contest::default(),
            counted_refused: 0,
            takeover_age_ns,
            blind_ns,
            stop_until: None,
            observed: run.now(),
        })
    }

    /// In lockstep: whether the next tick has to wait for the learner or the recorder.
    fn is_held(&mut self, run: &TickLoop, now: Instant) -> bool {
        if run.member.is_stopping() {
            self.swap.end_wait(&mut self.controller);
            return false;
        }
        let recorder = self.recorder.as_mut();
        self.swap.holds_tick(now, &mut self.controller)
            || recorder.is_some_and(|recorder| recorder.holds_tick(now))
    }

    /// The next tick that is due, once its wait has begun.
    fn begin(&mut self, run: &TickLoop) -> Option<Begun> {
        let now = run.now();
        self.swap.exchange(&mut self.controller);
        let due = self.waiting.tick(run, &mut self.ports, &mut self.inputs)?;
        if self.inputs.observation.get().is_some() {
            self.observed = now;
        }
        Some(self.waiting.begin(&self.inputs, due, run.now()))
    }

    /// Waits between ticks, in lockstep. A world that waits for its command is not silent.
    fn hold(&mut self, run: &TickLoop, until: Instant, now: Instant) {
        run.wait(Some(until), now);
        self.observed = run.now();
    }

    fn intent(&mut self, run: &TickLoop) -> Intent {
        match self.stop_until {
            Some(_) => Intent::Stop,
            None if self.contest.look(&run.member.wire, run.now()) => Intent::Contested,
            None => Intent::Drive,
        }
    }

    /// The newest takeover message that the door admits.
    fn read_takeover(&mut self, clock: RunClock) {
        let limit_ns = self.takeover_age_ns;
        let at = &mut self.inputs.admitted;
        let door = |takeover: &Takeover| {
            let now = clock.now();
            let admitted = takeover.admit(now, limit_ns);
            admitted.inspect(|()| at.takeover_ns = now.0)
        };
        self.ports
            .takeovers
            .newest_into(&mut self.inputs.takeover, door);
    }

    /// The number of the tick, and whether it answers a new observation. A refused
    /// observation does not give the tick its number; neither does one whose own tick is
    /// over, because that number is used.
    fn number(&mut self, due: &DueTick, is_admitted: bool) -> (u64, Origin) {
        let observation = self.inputs.observation.get();
        let of_this_tick = observation.filter(|o| is_admitted && o.scheduled_ns == due.scheduled.0);
        let origin = of_this_tick.map(origin);
        match origin {
            Some((_, tick)) if origin != self.waiting.answered => {
                self.waiting.answered = origin;
                (tick, Origin::New)
            }
            // An observation of a foreign process may carry the largest tick number.
            _ => {
                let last = self.controller.step().header.tick;
                let tick = last.saturating_add(1 + due.skipped);
                (tick, origin.map_or(Origin::None, |_| Origin::Answered))
            }
        }
    }

    /// Accounts for the tick on the run's clock, as planner and world do; returns how
    /// many were skipped before it. In lockstep a restarted world begins its clock anew,
    /// and the account goes on.
    fn take(&mut self, due: &DueTick, now: Instant, origin: Origin) -> u64 {
        let schedule = &mut self.waiting.schedule;
        match (self.waiting.lockstep, origin) {
            // Counted when the tick was released.
            (false, _) => due.skipped,
            (true, Origin::None) => schedule.take(schedule.next()),
            (true, Origin::New | Origin::Answered) => schedule.take(now.max(schedule.next())),
        }
    }

    /// The tick is done: counts it, and what was skipped before it.
    fn account(&mut self, telemetry: &mut Telemetry, done: &Done) {
        let (step, schedule) = (self.controller.step(), &self.waiting.schedule);
        let times = &step.timings;
        telemetry.record_tick(Tick {
            due: done.due.due,
            released: Some(done.event),
            begun: Instant(times.started_ns),
            done: done.at,
        });
        let skipped = schedule.skipped_before(done.due.scheduled, done.due.skipped);
        telemetry.record_skipped(skipped, Instant(times.started_ns));
        telemetry.note_deadline(Deadline {
            tick: step.header.tick,
            deadline: done.deadline,
            done: done.at,
            skipped: done.due.skipped,
            period_ns: schedule.period_ns(),
        });
        if times.released_ns > 0 && done.is_sent {
            let response_ns = times.commanded_ns.saturating_sub(times.released_ns);
            telemetry.timing.response.record(response_ns);
        }
        if done.origin == Origin::New {
            count_ages(step, &mut telemetry.timing);
        }
        let health = &mut telemetry.health;
        schedule.report(health);
        health.header.tick = step.header.tick;
        health.late += u64::from(Instant(times.commanded_ns) > done.deadline);
        if self.stop_until.is_none() {
            health.state = HealthState::Running.code();
        }
    }

    /// The car stands, or no observation says whether it does.
    fn stands(&self) -> bool {
        let step = self.controller.step();
        step.observation_age_ns == u64::MAX || step.observation.ego.speed_mps.abs() < STANDING_MPS
    }
}

/// Which observation a tick is of.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Origin {
    /// One that had no tick yet.
    New,
    /// One that was answered before.
    Answered,
    /// None that was admitted.
    None,
}

/// What the account of a tick needs beside its step.
struct Done<'a> {
    due: &'a DueTick,
    /// When the event that released it happened.
    event: Instant,
    deadline: Instant,
    at: Instant,
    is_sent: bool,
    origin: Origin,
}

impl FixedRate for ControllerProcess {
    type Due = Begun;

    /// Connects to peers that came or came back.
    fn update_connections(&mut self) {
        self.ports.update_connections();
        if let Some(recorder) = &mut self.recorder {
            recorder.update_connections();
        }
    }

    fn stop(&mut self, run: &mut TickLoop, now: Instant) -> Flow {
        run.telemetry.health.state = HealthState::Stopping.code();
        let until = *self.stop_until.get_or_insert(now.after_ns(STOP_NS));
        // After this long without a world there is no car to brake.
        let is_alone = now.since_ns(self.observed) > self.blind_ns;
        match now >= until || is_alone {
            true => Flow::End,
            false => Flow::Continue,
        }
    }

    /// In lockstep a tick waits for its peers, the learner and the recorder here, between
    /// ticks: a model may think for longer than the supervisor accepts silence.
    fn await_tick(&mut self, run: &mut TickLoop) -> Option<Begun> {
        let now = run.now();
        if self.waiting.lockstep && self.is_held(run, now) {
            self.hold(run, now.after_ns(POLL_NS), now);
            return None;
        }
        let begun = match self.begun.take() {
            Some(begun) => begun,
            None => self.begin(run)?,
        };
        // A tick that brakes the car to a stop needs nothing.
        let needs_peers = self.waiting.lockstep && self.stop_until.is_none();
        let (ports, inputs) = (&mut self.ports, &mut self.inputs);
        if needs_peers && !self.waiting.has_peers(run, ports, inputs, &begun) {
            self.hold(run, begun.until, run.now());
            self.begun = Some(begun);
            return None;
        }
        Some(begun)
    }

    /// Plan, proposals, verdict, command, step, account; then the canary.
    fn tick(&mut self, run: &mut TickLoop, begun: Begun) -> Result<Flow, SetUpError> {
        let (due, started) = (begun.due, begun.started);
        let clock = run.member.clock;
        let intent = self.intent(run);
        let refused = run.member.wire.refused().total();
        self.inputs.refused = refused - self.counted_refused;
        self.counted_refused = refused;

        run.telemetry.begin(started);
        let observation = self.inputs.observation.get();
        let released_ns = observation.map_or(0, |o| o.released_ns);
        let event = match (due.release, observation) {
            (Release::Observation, Some(observation)) => observation.published(),
            (Release::Observation | Release::TimeOut, _) => due.due,
        };
        // While the planner works.
        if let Some(observation) = observation {
            self.controller.follow(observation);
        }
        self.waiting
            .peers(run, &mut self.ports, &mut self.inputs, &begun);
        let run_clock = self.waiting.clock(run, &self.inputs);
        self.read_takeover(run_clock);
        let planned = clock();
        run.telemetry.end(Part::Wait, planned);

        let now = match run_clock {
            RunClock::Machine(_) => planned,
            RunClock::Stands(now) => now,
        };
        let is_admitted = self.controller.admit(&self.inputs, now);
        let (tick, origin) = self.number(&due, is_admitted);
        self.controller.decide(tick, now, intent);
        self.inputs.clear();
        let decided = clock();
        run.telemetry.end(Part::Decide, decided);

        let deadline = due.scheduled.after_ns(self.waiting.schedule.period_ns());
        let is_sent = self.controller.complete(due.scheduled, decided);
        if is_sent {
            let command = &mut self.controller.step_mut().command;
            self.ports.commands.send(command);
        }
        let commanded = clock();
        self.controller.propose_in_shadow();

        let skipped = self.take(&due, now, origin);
        let step = self.controller.step_mut();
        step.skipped += skipped;
        step.timings.released_ns = released_ns;
        step.timings.started_ns = started.0;
        step.timings.planned_ns = planned.0;
        step.timings.commanded_ns = commanded.0;
        self.ports.steps.send(step);
        self.waiting.stepped = Some(tick);

        let at = clock();
        run.telemetry.end(Part::Send, at);
        let done = Done {
            due: &due,
            event,
            deadline,
            at,
            is_sent,
            origin,
        };
        self.account(&mut run.telemetry, &done);
        if intent == Intent::Stop && self.stands() {
            return Ok(Flow::End);
        }
        self.swap.after_tick(&mut self.controller);
        self.swap.end_tick(tick);
        if let Some(recorder) = &mut self.recorder {
            recorder.end_tick(tick);
        }
        Ok(Flow::Continue)
    }
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
        // The largest number means that none ever came.
        if age_ns != u64::MAX {
            timing.of_mut(measure).record(age_ns);
        }
    }
}
