//! The planner's side of a run, with the turns, deadlines and account of the built-in
//! planner.

use runtime::{Member, PlanTicks, TickLoop};
use shm_config::Instant;
use shm_config::message::{Message, Newest, Observation, Part, Plan};
use shm_config::services::{OBSERVATION, PLAN};

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
    ticks: PlanTicks,
    newest: Newest<Observation>,
    /// The observation that was taken last.
    observation: Box<Observation>,
    /// When it was received; `None` when no observation waits for a plan.
    received: Option<Instant>,
}

impl PlannerSide {
    /// Opens its ports.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn open(member: &Member) -> Result<Self, Failure> {
        Ok(Self {
            ports: Ports::open(&member.wire)?,
            ticks: PlanTicks::of(&member.config),
            newest: Newest::default(),
            observation: Box::default(),
            received: None,
        })
    }

    /// The newest admissible observation, if the planner has its turn at it.
    pub fn take(&mut self, run: &mut TickLoop) -> Option<Observation> {
        self.ports.update_connections();
        let observations = &mut self.ports.observations;
        let received = self.ticks.take(run, observations, &mut self.newest)?;
        run.telemetry.begin(received);
        run.telemetry.end(Part::Admit, run.member.now());
        self.received = Some(received);
        let observation = self.newest.get()?;
        self.observation.assign(observation);
        Some(*observation)
    }

    /// Publishes the plan of the observation taken last. Header, origin, planning time
    /// and lateness are filled in here.
    ///
    /// # Errors
    /// When no observation waits for a plan, or the check refuses it; another plan may be
    /// given then.
    pub fn answer(&mut self, run: &mut TickLoop, plan: &mut Plan) -> Result<(), Failure> {
        let Some(received) = self.received else {
            return Err(Failure::invalid("no observation waits for a plan"));
        };
        let observation = &*self.observation;
        let ego = &observation.ego;
        plan.header = observation.header;
        plan.origin_x_world_m = ego.x_world_m;
        plan.origin_y_world_m = ego.y_world_m;
        plan.origin_heading_world_rad = ego.heading_world_rad;
        plan.lateness = Plan::default().lateness;
        let planned = run.now();
        plan.planning_ns = planned.since_ns(received);
        plan.check()
            .map_err(|refusal| Failure::refused(PLAN.name, &refusal))?;
        self.received = None;
        run.telemetry.end(Part::Search, planned);
        let is_to_send = self.ticks.is_to_send(observation, planned, plan);
        let is_lost = is_to_send && !self.ports.plans.send(plan);
        let done = run.now();
        run.telemetry.end(Part::Send, done);
        self.ticks.account(run, (observation, received), done);
        match is_lost {
            false => Ok(()),
            true => Err(no_space(PLAN.name)),
        }
    }
}
