use shm_config::config::planner::Method;
use shm_config::config::{Config, OutOfRange};
use shm_config::message::{Observation, Plan};

use crate::{Grid, Mpc, RrtStar, Tree};

/// Turns observations into plans by the configured method.
#[derive(Debug)]
pub enum Planner {
    /// The paper's.
    RrtStar(RrtStar),
    /// Model-predictive control.
    Mpc(Box<Mpc>),
}

impl Planner {
    /// The only place that allocates, except for the MPC's solver.
    ///
    /// # Errors
    /// The first number of the configuration that is outside its limits.
    pub fn new(config: &Config) -> Result<Self, OutOfRange> {
        match config.planner.method {
            Method::RrtStar | Method::Informed | Method::Kinodynamic => {
                RrtStar::new(config.planner).map(Self::RrtStar)
            }
            Method::Mpc => Ok(Self::Mpc(Box::new(Mpc::new(config)))),
        }
    }

    /// Plans for one admitted observation.
    ///
    /// Writes all of `out` except the producer and sequence number of its header
    /// and the planning time, which are the caller's.
    pub fn plan(&mut self, observation: &Observation, out: &mut Plan) {
        match self {
            Self::RrtStar(planner) => planner.plan(observation, out),
            Self::Mpc(planner) => planner.plan(observation, out),
        }
    }

    /// The grid of the last plan; none of methods without one.
    pub fn grid(&self) -> Option<&Grid> {
        match self {
            Self::RrtStar(planner) => Some(planner.grid()),
            Self::Mpc(_) => None,
        }
    }

    /// The tree of the last plan; none of methods without one.
    pub fn tree(&self) -> Option<&Tree> {
        match self {
            Self::RrtStar(planner) => Some(planner.tree()),
            Self::Mpc(_) => None,
        }
    }

    /// An episode begins: nothing of what was before counts any more. Methods
    /// with a memory also notice it themselves by the observation's header.
    pub fn forget(&mut self) {
        match self {
            Self::RrtStar(_) => {}
            Self::Mpc(planner) => planner.forget(),
        }
    }
}
