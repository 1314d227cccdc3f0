//! The planner process: a plan for every observation at its turn.

use runtime::{FixedRate, Flow, Member, PlanTicks, SetUpError, TickLoop};
use shm_config::Instant;
use shm_config::config::Config;
use shm_config::message::{Newest, Observation, Part, Plan};

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
    ticks: PlanTicks,
}

/// It is the newest observation's turn.
pub struct Due {
    /// When it was received, before it was checked: the tick begins then.
    received: Instant,
}

impl PlannerProcess {
    /// Allocates everything.
    ///
    /// # Errors
    /// When the planner's configuration is out of range.
    pub fn new(config: &Config, ports: Ports) -> Result<Self, SetUpError> {
        Ok(Self {
            ports,
            planner: Planner::new(config).map_err(|error| SetUpError::Own(error.to_string()))?,
            observation: Newest::default(),
            plan: Box::default(),
            ticks: PlanTicks::of(config),
        })
    }
}

impl FixedRate for PlannerProcess {
    type Due = Due;

    fn update_connections(&mut self) {
        self.ports.update_connections();
    }

    fn await_tick(&mut self, run: &mut TickLoop) -> Option<Due> {
        let observations = &mut self.ports.observations;
        if let Some(received) = self.ticks.take(run, observations, &mut self.observation) {
            return Some(Due { received });
        }
        run.wait(None, run.now());
        None
    }

    fn tick(&mut self, run: &mut TickLoop, due: Due) -> Result<Flow, SetUpError> {
        let Some(observation) = self.observation.get() else {
            return Ok(Flow::Continue);
        };
        let clock = run.member.clock;
        let telemetry = &mut run.telemetry;
        telemetry.begin(due.received);
        telemetry.end(Part::Admit, clock());
        let prepared = || telemetry.end(Part::Grid, clock());
        self.planner
            .plan_in_parts(observation, &mut self.plan, prepared);
        let planned = clock();
        telemetry.end(Part::Search, planned);
        self.plan.planning_ns = planned.since_ns(due.received);
        let is_to_send = self.ticks.is_to_send(observation, planned, &mut self.plan);
        if is_to_send {
            self.ports.plans.send(&mut self.plan);
        }
        let done = clock();
        telemetry.end(Part::Send, done);
        self.ticks.account(run, (observation, due.received), done);
        Ok(Flow::Continue)
    }
}
