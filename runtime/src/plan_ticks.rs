use std::cell::Cell;

use shm_config::config::{Config, Late};
use shm_config::message::{HealthState, Newest, Observation, Plan};
use shm_config::services::Process;
use shm_config::wire::Subscriber;
use shm_config::{Instant, PlanTurns, RunGrid};

use crate::{Deadline, Tick, TickLoop, TickSchedule};

/// The ticks of a planner: which observations are its turns, which plans are late, and
/// the account of what was due.
pub struct PlanTicks {
    grid: RunGrid,
    turns: PlanTurns,
    schedule: TickSchedule,
    is_lockstep: bool,
    /// Whether skipped turns are instants of the machine's clock: at a rate below the
    /// run's each episode begins its turns anew, and lockstep has a clock of its own.
    keeps_grid: bool,
    late: Late,
}

impl PlanTicks {
    /// Those of a configuration.
    pub fn of(config: &Config) -> Self {
        let is_lockstep = config.run.is_lockstep();
        Self {
            grid: RunGrid::of(config),
            turns: PlanTurns::every(config.plan_ticks()),
            schedule: TickSchedule::following(config.run.period_ns() * config.plan_ticks()),
            is_lockstep,
            keeps_grid: !is_lockstep && config.tick_ns(Process::Planner).is_some(),
            late: config.deadlines.planner,
        }
    }

    /// Keeps the newest admissible observation. If the planner has its turn at it, returns
    /// when it was received, before it was checked: the tick begins then. Between two turns
    /// the controller moves the last plan on.
    pub fn take(
        &mut self,
        run: &TickLoop,
        observations: &mut Subscriber<Observation>,
        newest: &mut Newest<Observation>,
    ) -> Option<Instant> {
        let received = Cell::new(Instant(0));
        let door = |observation: &Observation| {
            received.set(run.now());
            self.grid.admit(observation, received.get())
        };
        let has_come = observations.newest_into(newest, door);
        let observation = newest.get().filter(|_| has_come)?;
        let is_turn = self.turns.take(&observation.header);
        is_turn.then(|| received.get())
    }

    /// Whether the plan of an observation, ready at `planned`, is to be sent: a late one
    /// becomes what `deadlines.planner` says.
    pub fn is_to_send(&self, observation: &Observation, planned: Instant, plan: &mut Plan) -> bool {
        let deadline_ns = observation.scheduled_ns + self.schedule.period_ns();
        let is_late = !self.is_lockstep && planned.0 > deadline_ns;
        !is_late || plan.answer_late(self.late)
    }

    /// The tick of an observation is done: counts it, and what was skipped before it.
    pub fn account(
        &mut self,
        run: &mut TickLoop,
        (observation, received): (&Observation, Instant),
        done: Instant,
    ) {
        let (taken, scheduled) = (
            observation.header.taken(),
            Instant(observation.scheduled_ns),
        );
        let telemetry = &mut run.telemetry;
        telemetry.record_tick(Tick {
            due: scheduled,
            released: Some(observation.published()),
            begun: received,
            done,
        });
        let now = match self.is_lockstep {
            true => taken,
            false => received,
        };
        let age_ns = now.since_ns(taken);
        telemetry.timing.observation_age.record(age_ns);
        let skipped = self.schedule.take(match self.is_lockstep {
            // A restarted world restarts its clock; the account continues.
            true => taken.max(self.schedule.next()),
            false => scheduled,
        });
        let skipped = if self.keeps_grid { skipped } else { 0 };
        let before = self.schedule.skipped_before(scheduled, skipped);
        telemetry.record_skipped(before, received);
        let period_ns = self.schedule.period_ns();
        let deadline = scheduled.after_ns(period_ns);
        telemetry.note_deadline(Deadline {
            tick: observation.header.tick,
            deadline,
            done,
            skipped,
            period_ns,
        });
        let health = &mut telemetry.health;
        self.schedule.report(health);
        health.header.tick = observation.header.tick;
        health.late += u64::from(done > deadline);
        health.state = HealthState::Running.code();
    }
}
