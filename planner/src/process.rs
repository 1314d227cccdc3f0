//! The planner process: a plan for every observation at its turn.

use std::cell::Cell;

use runtime::{Deadline, FixedRate, Flow, Member, SetUpError, Tick, TickLoop, TickSchedule};
use shm_config::config::{Config, Late};
use shm_config::message::{Header, HealthState, Newest, Observation, Part, Plan};
use shm_config::services::Process;
use shm_config::{Instant, PlanTurns, RunGrid};

use crate::Planner;
use crate::ports::Ports;

/// Runs the planner until it is stopped.
///
/// # Errors
/// When shared memory or the configuration refuses.
pub fn run(member: Member, ports: Ports) -> Result<(), SetUpError> {
    let mut process = PlannerProcess::new(&member.config, ports)?;
    TickLoop::start(member)?.run(&mut process)
}

/// The planner between its ports.
pub struct PlannerProcess {
    ports: Ports,
    planner: Planner,
    /// The newest observation.
    observation: Newest<Observation>,
    plan: Box<Plan>,
    grid: RunGrid,
    turns: PlanTurns,
    schedule: TickSchedule,
    lockstep: bool,
    /// Whether skipped turns are instants of the machine's clock: at a rate below the
    /// run's each episode begins its turns anew, and lockstep has a clock of its own.
    keeps_grid: bool,
    late: Late,
}

/// It is the newest observation's turn.
pub struct Due {
    /// When it was received, before it was checked: the tick begins then.
    received: Instant,
    header: Header,
    scheduled: Instant,
    /// When it woke its readers.
    published: Instant,
}

impl PlannerProcess {
    /// Allocates everything.
    ///
    /// # Errors
    /// When the planner's configuration is out of range.
    pub fn new(config: &Config, ports: Ports) -> Result<Self, SetUpError> {
        let lockstep = config.run.is_lockstep();
        Ok(Self {
            ports,
            planner: Planner::new(config).map_err(|error| SetUpError::Own(error.to_string()))?,
            observation: Newest::default(),
            plan: Box::default(),
            grid: RunGrid::of(config),
            turns: PlanTurns::every(config.plan_ticks()),
            schedule: TickSchedule::following(config.run.period_ns() * config.plan_ticks()),
            lockstep,
            keeps_grid: !lockstep && config.tick_ns(Process::Planner).is_some(),
            late: config.deadlines.planner,
        })
    }

    /// The tick is done: counts it, and what was skipped before it.
    fn account(&mut self, run: &mut TickLoop, due: &Due, done: Instant) {
        let (taken, scheduled) = (due.header.taken(), due.scheduled);
        let telemetry = &mut run.telemetry;
        telemetry.record_tick(Tick {
            due: scheduled,
            released: Some(due.published),
            begun: due.received,
            done,
        });
        let now = match self.lockstep {
            true => taken,
            false => due.received,
        };
        let age_ns = now.since_ns(taken);
        telemetry.timing.observation_age.record(age_ns);
        let skipped = self.schedule.take(match self.lockstep {
            // A restarted world restarts its clock; the account continues.
            true => taken.max(self.schedule.next()),
            false => scheduled,
        });
        let skipped = if self.keeps_grid { skipped } else { 0 };
        let before = self.schedule.skipped_before(scheduled, skipped);
        telemetry.record_skipped(before, due.received);
        let deadline = scheduled.after_ns(self.schedule.period_ns());
        telemetry.note_deadline(Deadline {
            tick: due.header.tick,
            deadline,
            done,
            skipped,
            period_ns: self.schedule.period_ns(),
        });
        let health = &mut telemetry.health;
        self.schedule.report(health);
        health.header.tick = due.header.tick;
        health.late += u64::from(done > deadline);
        health.state = HealthState::Running.code();
    }
}

impl FixedRate for PlannerProcess {
    type Due = Due;

    fn update_connections(&mut self) {
        self.ports.update_connections();
    }

    fn await_tick(&mut self, run: &mut TickLoop) -> Option<Due> {
        let received = Cell::new(Instant(0));
        let door = |observation: &Observation| {
            received.set(run.now());
            self.grid.admit(observation, received.get())
        };
        let has_come = self
            .ports
            .observations
            .newest_into(&mut self.observation, door);
        if let Some(observation) = self.observation.get().filter(|_| has_come)
            // Between two turns the controller moves the last plan on.
            && self.turns.take(&observation.header)
        {
            return Some(Due {
                received: received.get(),
                header: observation.header,
                scheduled: Instant(observation.scheduled_ns),
                published: observation.published(),
            });
        }
        run.wait(None, run.now());
        None
    }

    fn tick(&mut self, run: &mut TickLoop, due: Due) -> Result<Flow, SetUpError> {
        let clock = run.member.clock;
        let telemetry = &mut run.telemetry;
        telemetry.begin(due.received);
        telemetry.end(Part::Admit, clock());
        let prepared = || telemetry.end(Part::Grid, clock());
        if let Some(observation) = self.observation.get() {
            self.planner
                .plan_in_parts(observation, &mut self.plan, prepared);
        }
        let planned = clock();
        telemetry.end(Part::Search, planned);
        self.plan.planning_ns = planned.since_ns(due.received);
        let deadline = due.scheduled.after_ns(self.schedule.period_ns());
        let is_late = !self.lockstep && planned > deadline;
        if !is_late || self.plan.answer_late(self.late) {
            self.ports.plans.send(&mut self.plan);
        }
        let done = clock();
        telemetry.end(Part::Send, done);
        self.account(run, &due, done);
        Ok(Flow::Continue)
    }
}
