use shm_config::config::planner::Method;
use shm_config::config::{Config, OutOfRange};
use shm_config::message::{Observation, Plan};

use crate::{Informed, Kinodynamic, RrtStar};

/// Turns observations into plans by the configured method.
#[derive(Debug)]
pub enum Planner {
    /// The paper's.
    RrtStar(Box<RrtStar>),
    /// The paper's with a memory and informed sampling.
    Informed(Box<Informed>),
    /// RRT* over the bicycle.
    Kinodynamic(Box<Kinodynamic>),
}

impl Planner {
    /// The only place that allocates, except for the MPC's solver.
    ///
    /// # Errors
    /// The first number of the configuration that is outside its limits.
    pub fn new(config: &Config) -> Result<Self, OutOfRange> {
        match config.planner.method {
            Method::RrtStar | Method::Mpc => {
                RrtStar::new(config.planner).map(|planner| Self::RrtStar(Box::new(planner)))
            }
            Method::Informed => Informed::new(config.planner, config.informed)
                .map(|planner| Self::Informed(Box::new(planner))),
            Method::Kinodynamic => {
                Kinodynamic::new(config).map(|planner| Self::Kinodynamic(Box::new(planner)))
            }
        }
    }

    /// Plans for one admitted observation.
    ///
    /// Writes all of `out` except the producer and sequence number of its header
    /// and the planning time, which are the caller's.
    pub fn plan(&mut self, observation: &Observation, out: &mut Plan) {
        match self {
            Self::RrtStar(planner) => planner.plan(observation, out),
            Self::Informed(planner) => planner.plan(observation, out),
            Self::Kinodynamic(planner) => planner.plan(observation, out),
        }
    }

    /// An episode begins: nothing of what was before counts any more. Methods
    /// with a memory also notice it themselves by the observation's header.
    pub fn forget(&mut self) {
        match self {
            Self::RrtStar(_) | Self::Kinodynamic(_) => {}
            Self::Informed(planner) => planner.forget(),
        }
    }
}
