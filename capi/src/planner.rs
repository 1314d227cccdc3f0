//! The planner's side of a run: turns, deadlines and accounts, as those of the built-in
//! planner (`planner/src/process.rs`).

use std::cell::Cell;

use runtime::{Deadline, Member, Tick, TickLoop, TickSchedule};
use shm_config::config::Late;
use shm_config::message::{HealthState, Message, Observation, Part, Plan};
use shm_config::services::{OBSERVATION, PLAN, Process};
use shm_config::{Instant, PlanTurns, RunGrid};

use crate::failure::Failure;
use crate::port::no_space;

shm_config::ports! {
    /// What a planner reads and publishes.
    pub struct Ports of Planner {
        /// What the car perceives.
        observations: read OBSERVATION: Observation,
        /// Its answers.
        plans: write PLAN: Plan,
    }
}

/// The services that the loop publishes.
pub const PUBLISHED: &[&str] = &[PLAN.name];

/// A planner between its ports.
pub struct PlannerSide {
    ports: Ports,
    grid: RunGrid,
    turns: PlanTurns,
    schedule: TickSchedule,
    is_lockstep: bool,
    keeps_grid: bool,
    late: Late,
    /// The observation that is being answered, and when it was received.
    due: Option<(Box<Observation>, Instant)>,
}

impl PlannerSide {
    /// Opens its ports.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn open(member: &Member) -> Result<Self, Failure> {
        let config = &member.config;
        let is_lockstep = config.run.is_lockstep();
        Ok(Self {
            ports: Ports::open(&member.wire)?,
            grid: RunGrid::of(config),
            turns: PlanTurns::every(config.plan_ticks()),
            schedule: TickSchedule::following(config.run.period_ns() * config.plan_ticks()),
            is_lockstep,
            keeps_grid: !is_lockstep && config.tick_ns(Process::Planner).is_some(),
            late: config.deadlines.planner,
            due: None,
        })
    }

    /// The newest admissible observation, if the planner has its turn at it.
    pub fn take(&mut self, run: &mut TickLoop) -> Option<Observation> {
        self.ports.update_connections();
        let received = Cell::new(Instant(0));
        let door = |observation: &Observation| {
            received.set(run.now());
            self.grid.admit(observation, received.get())
        };
        let observation = self.ports.observations.newest(door)?;
        if !self.turns.take(&observation.header) {
            return None;
        }
        let received = received.get();
        run.telemetry.begin(received);
        run.telemetry.end(Part::Admit, run.member.now());
        self.due = Some((Box::new(observation), received));
        Some(observation)
    }

    /// Publishes the plan of the observation taken last. Header, origin, planning time
    /// and lateness are filled in here.
    ///
    /// # Errors
    /// When no observation waits for a plan, or the check refuses it; another plan may be
    /// given then.
    pub fn answer(&mut self, run: &mut TickLoop, mut plan: Box<Plan>) -> Result<(), Failure> {
        let Some((observation, received)) = self.due.take() else {
            return Err(Failure::invalid("no observation waits for a plan"));
        };
        let ego = &observation.ego;
        plan.header = observation.header;
        plan.origin_x_world_m = ego.x_world_m;
        plan.origin_y_world_m = ego.y_world_m;
        plan.origin_heading_world_rad = ego.heading_world_rad;
        plan.lateness = Plan::default().lateness;
        let planned = run.now();
        plan.planning_ns = planned.since_ns(received);
        if let Err(refusal) = plan.check() {
            self.due = Some((observation, received));
            return Err(Failure::refused(PLAN.name, &refusal));
        }
        run.telemetry.end(Part::Search, planned);
        let deadline_ns = observation.scheduled_ns + self.schedule.period_ns();
        let is_late = !self.is_lockstep && planned.0 > deadline_ns;
        let sent = (is_late && !plan.answer_late(self.late)) || self.ports.plans.send(&mut plan);
        let done = run.now();
        run.telemetry.end(Part::Send, done);
        self.account(run, (&observation, received), done);
        match sent {
            true => Ok(()),
            false => Err(no_space(PLAN.name)),
        }
    }

    /// Counts the tick, and what was skipped before it.
    fn account(
        &mut self,
        run: &mut TickLoop,
        (observation, received): (&Observation, Instant),
        done: Instant,
    ) {
        let taken = observation.header.taken();
        let scheduled = Instant(observation.scheduled_ns);
        let telemetry = &mut run.telemetry;
        telemetry.record_tick(Tick {
            due: scheduled,
            released: Some(observation.published()),
            begun: received,
            done,
        });
        let now = if self.is_lockstep { taken } else { received };
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
