use shm_config::config::planner::Method;
use shm_config::config::{Config, Late, OutOfRange};
use shm_config::message::{Lateness, Observation, Plan};
use tracker::Moving;

use crate::{Grid, Informed, Kinodynamic, Mpc, RrtStar, Tree};

/// Turns observations into plans by the configured method.
#[derive(Debug)]
pub enum Planner {
    /// The paper's.
    RrtStar(Box<RrtStar>),
    /// The paper's with a memory and informed sampling.
    Informed(Box<Informed>),
    /// RRT* over the bicycle.
    Kinodynamic(Box<Kinodynamic>),
    /// Model-predictive control.
    Mpc(Box<Mpc>),
}

impl Planner {
    /// The only place that allocates, except for the MPC's solver.
    ///
    /// # Errors
    /// The first number of the configuration that is outside its limits.
    pub fn new(config: &Config) -> Result<Self, OutOfRange> {
        let footprint = config.vehicle.footprint();
        Ok(match config.planner.method {
            Method::RrtStar => {
                let planner = RrtStar::new(config.planner)?;
                Self::RrtStar(Box::new(planner.for_car(footprint)))
            }
            Method::Informed => {
                let planner = Informed::new(config.planner, config.informed)?;
                Self::Informed(Box::new(planner.for_car(footprint)))
            }
            Method::Kinodynamic => Self::Kinodynamic(Box::new(Kinodynamic::new(config)?)),
            Method::Mpc => Self::Mpc(Box::new(Mpc::new(config))),
        })
    }

    /// Plans for one admitted observation.
    ///
    /// Writes all of `out` except the producer and sequence number of its header
    /// and the planning time, which are the caller's.
    pub fn plan(&mut self, observation: &Observation, out: &mut Plan) {
        self.plan_in_parts(observation, out, || ());
    }

    /// The same; `prepared` is called when grid, goal and predictions are ready and the
    /// search begins.
    pub fn plan_in_parts(
        &mut self,
        observation: &Observation,
        out: &mut Plan,
        prepared: impl FnOnce(),
    ) {
        match self {
            Self::RrtStar(planner) => planner.plan_in_parts(observation, out, prepared),
            Self::Informed(planner) => planner.plan_in_parts(observation, out, prepared),
            Self::Kinodynamic(planner) => planner.plan_in_parts(observation, out, prepared),
            Self::Mpc(planner) => planner.plan_in_parts(observation, out, prepared),
        }
    }

    /// Plans without the plans before: the answer depends on this observation, and on what
    /// is known to move around it, alone. Methods other than [`Mpc`] take all to rest.
    pub fn plan_anew(&mut self, observation: &Observation, moving: &[Moving], out: &mut Plan) {
        match self {
            Self::Mpc(planner) => planner.plan_anew(observation, moving, out),
            Self::RrtStar(_) | Self::Informed(_) | Self::Kinodynamic(_) => {
                self.forget();
                self.plan(observation, out);
            }
        }
    }

    /// Plans again as a recorded plan was made: the caller's fields are its own, and the
    /// solver of [`Mpc`] gives up where it did. It gives up at a limit of time, too, which
    /// an observation does not tell; a plan that its solver found has iterations. A late
    /// plan becomes what this setting says.
    ///
    /// Of a configuration in lockstep, which has no limit of time. Methods with a memory
    /// need the plans in order.
    pub fn plan_again(
        &mut self,
        observation: &Observation,
        (recorded, late): (&Plan, Late),
        out: &mut Plan,
    ) {
        (out.header, out.planning_ns) = (recorded.header, recorded.planning_ns);
        match self {
            Self::Mpc(planner) => planner.plan_again(observation, recorded, out),
            Self::RrtStar(_) | Self::Informed(_) | Self::Kinodynamic(_) => {
                self.plan(observation, out);
            }
        }
        if recorded.lateness != Lateness::OnTime.code() {
            out.answer_late(late);
        }
    }

    /// Whether a plan depends on the plans before it.
    pub fn remembers(&self) -> bool {
        matches!(self, Self::Informed(_) | Self::Mpc(_))
    }

    /// The grid of the last plan; none of methods without one.
    pub fn grid(&self) -> Option<&Grid> {
        match self {
            Self::RrtStar(planner) => Some(planner.grid()),
            Self::Informed(planner) => Some(planner.grid()),
            Self::Kinodynamic(planner) => Some(planner.grid()),
            Self::Mpc(_) => None,
        }
    }

    /// The tree of the last plan; none of methods without one of straight edges.
    pub fn tree(&self) -> Option<&Tree> {
        match self {
            Self::RrtStar(planner) => Some(planner.tree()),
            Self::Informed(planner) => Some(planner.tree()),
            Self::Kinodynamic(_) | Self::Mpc(_) => None,
        }
    }

    /// Forgets the last plans: an episode begins. Methods with a memory also detect it
    /// by the observation's header.
    pub fn forget(&mut self) {
        match self {
            Self::RrtStar(_) | Self::Kinodynamic(_) => {}
            Self::Informed(planner) => planner.forget(),
            Self::Mpc(planner) => planner.forget(),
        }
    }
}
