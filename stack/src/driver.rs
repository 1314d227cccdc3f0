//! The drivers of an episode.

use anyhow::Context;
use controller::{Policy, Terms};
use hdrhistogram::Histogram;
use shm_config::config::planner::Method;
use shm_config::config::{Config, GateMode};
use shm_config::message::{
    Command, Driver, INPUTS_WITH_MOTION, MOTION_AT_REST, MOTION_FEATURES, Observation, Plan, Reason,
};
use sim::World;
use sim::idm::Idm;
use tracker::Tracker;
use vehicle::Action;

use crate::lane_keeper::keep_lane;
use crate::{Clock, Stack};

/// Steps between two lane changes of MetaDrive's driver; its timer begins anywhere
/// below (`LANE_CHANGE_FREQ`).
const LANE_CHANGE_STEPS: u64 = 50;
/// Longest planning time of the histogram, us: ten periods.
const PLANNING_MAX_US: u64 = 1_000_000;

/// The drivers that can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriverKind {
    /// Planner and controller of this stack, with the safety check of the tick; plans
    /// as `planner.method` says.
    Expert,
    /// The expert with the paper's planner.
    RrtStar,
    /// The expert with informed RRT*.
    Informed,
    /// The expert with RRT* on edges that the car can drive.
    Kinodynamic,
    /// The expert with model-predictive control.
    Mpc,
    /// A simple lane keeper that sees only the observation.
    Lane,
    /// MetaDrive's driver of the other cars, which knows the world's state.
    Idm,
    /// The policy of this file alone, without expert, safety check or brake.
    /// The name lives as long as the program, as all of its arguments do.
    Policy(&'static str),
}

/// The drivers with a name.
const NAMED: [DriverKind; 7] = [
    DriverKind::Expert,
    DriverKind::RrtStar,
    DriverKind::Informed,
    DriverKind::Kinodynamic,
    DriverKind::Mpc,
    DriverKind::Lane,
    DriverKind::Idm,
];

impl std::str::FromStr for DriverKind {
    type Err = String;

    fn from_str(text: &str) -> Result<DriverKind, String> {
        if let Some(named) = NAMED.into_iter().find(|kind| kind.word() == text) {
            return Ok(named);
        }
        if text.ends_with(".onnx") {
            return Ok(DriverKind::Policy(text.to_string().leak()));
        }
        let words = NAMED.map(DriverKind::word).join(", ");
        Err(format!(
            "must be {words}, or the name of a policy file, FILE.onnx"
        ))
    }
}

impl DriverKind {
    /// As on the command line.
    pub fn word(self) -> &'static str {
        match self {
            DriverKind::Expert => "expert",
            DriverKind::RrtStar => "rrt-star",
            DriverKind::Informed => "informed",
            DriverKind::Kinodynamic => "kinodynamic",
            DriverKind::Mpc => "mpc",
            DriverKind::Lane => "lane",
            DriverKind::Idm => "idm",
            DriverKind::Policy(file) => file,
        }
    }

    /// As a part of a file's name.
    pub fn file_word(self) -> &'static str {
        let path = std::path::Path::new(self.word());
        path.file_stem()
            .and_then(|stem| stem.to_str())
            .unwrap_or("policy")
    }

    /// The planning method of the name; none when the configuration says it, or
    /// the driver does not plan.
    pub fn method(self) -> Option<Method> {
        match self {
            DriverKind::RrtStar => Some(Method::RrtStar),
            DriverKind::Informed => Some(Method::Informed),
            DriverKind::Kinodynamic => Some(Method::Kinodynamic),
            DriverKind::Mpc => Some(Method::Mpc),
            DriverKind::Expert | DriverKind::Lane | DriverKind::Idm | DriverKind::Policy(_) => None,
        }
    }

    /// The expert that plans by a method.
    pub fn of_method(method: Method) -> DriverKind {
        match method {
            Method::RrtStar => DriverKind::RrtStar,
            Method::Informed => DriverKind::Informed,
            Method::Kinodynamic => DriverKind::Kinodynamic,
            Method::Mpc => DriverKind::Mpc,
        }
    }

    /// The configuration with this driver's planning method.
    pub fn configure(self, config: &Config) -> Config {
        let mut config = config.clone();
        if let Some(method) = self.method() {
            config.planner.method = method;
        }
        config
    }
}

/// A driver of episodes.
pub struct EpisodeDriver {
    clock: Clock,
    planning_us: Histogram<u64>,
    kind: Loaded,
}

/// A driver with what it needs in memory.
enum Loaded {
    Expert(Box<Stack>),
    Lane,
    Idm(Idm),
    Policy(Box<PolicyAlone>),
}

/// A policy without expert and safety check, the buffer of its features, and what follows
/// the bodies around the car for it.
struct PolicyAlone {
    policy: Box<dyn Policy>,
    features: [f32; INPUTS_WITH_MOTION],
    tracker: Tracker,
}

impl EpisodeDriver {
    /// A driver of this kind. The configuration is that of a run; its gate is
    /// always the expert's, as with `./vlaps up --gate expert`.
    ///
    /// # Errors
    /// When the planner's configuration is out of range, or the policy's file is
    /// refused.
    pub fn new(kind: DriverKind, config: &Config, clock: Clock) -> anyhow::Result<EpisodeDriver> {
        let mut config = kind.configure(config);
        config.gate.mode = GateMode::Expert;
        // The result must not depend on the machine's speed.
        config.run.clock = shm_config::config::Clock::Lockstep;
        let driver = match kind {
            DriverKind::Expert
            | DriverKind::RrtStar
            | DriverKind::Informed
            | DriverKind::Kinodynamic
            | DriverKind::Mpc => Loaded::Expert(Box::new(Stack::new(&config)?)),
            DriverKind::Lane => Loaded::Lane,
            DriverKind::Idm => Loaded::Idm(Idm::new(0, 0)),
            DriverKind::Policy(file) => {
                let bytes = read(file).with_context(|| file.to_string())?;
                let terms = Terms {
                    config: &config,
                    version: 1,
                    clock,
                };
                let policy = controller::build(&bytes, &terms).with_context(|| file.to_string())?;
                return Ok(EpisodeDriver::of_policy(policy, clock));
            }
        };
        Ok(EpisodeDriver {
            clock,
            planning_us: planning_histogram(),
            kind: driver,
        })
    }

    /// A policy alone as the driver, without expert, safety check or brake.
    pub fn of_policy(policy: Box<dyn Policy>, clock: Clock) -> EpisodeDriver {
        EpisodeDriver {
            clock,
            planning_us: planning_histogram(),
            kind: Loaded::Policy(Box::new(PolicyAlone {
                policy,
                features: [0.0; INPUTS_WITH_MOTION],
                tracker: Tracker::default(),
            })),
        }
    }

    /// Prepares for a new episode: no state of the episode before is left, so an
    /// episode depends on its seed alone.
    pub fn begin(&mut self, seed: u64) {
        match &mut self.kind {
            Loaded::Expert(stack) => stack.forget(),
            Loaded::Lane => {}
            Loaded::Policy(alone) => alone.tracker.forget(),
            Loaded::Idm(idm) => {
                *idm = Idm::new((seed.wrapping_mul(31) % LANE_CHANGE_STEPS) as u32, seed);
            }
        }
    }

    /// The command for what is observed now in the built-in world.
    pub fn command(&mut self, observation: &Observation, world: &mut World) -> Command {
        self.steer(observation, |idm| world.advise(idm).clamped())
    }

    /// The command in a world outside this process, of which the observation is all
    /// that is known: MetaDrive's own driver brakes there.
    pub fn answer(&mut self, observation: &Observation) -> Command {
        self.steer(observation, |_| Action::BRAKE)
    }

    /// The command; `advise` is the answer of MetaDrive's own driver.
    fn steer(
        &mut self,
        observation: &Observation,
        advise: impl FnOnce(&mut Idm) -> Action,
    ) -> Command {
        let scripted = |action: Action| Command {
            header: observation.header,
            steer: action.steer,
            pedal: action.pedal,
            driver: Driver::Expert.code(),
            reason: Reason::Configured.code(),
        };
        match &mut self.kind {
            Loaded::Expert(stack) => {
                let begun = (self.clock)();
                stack.plan(observation);
                let planning_ns = (self.clock)().since_ns(begun);
                self.planning_us
                    .saturating_record(planning_ns.div_ceil(1000));
                stack.control(observation).command
            }
            Loaded::Lane => scripted(keep_lane(observation)),
            Loaded::Idm(idm) => scripted(advise(idm)),
            Loaded::Policy(alone) => Command {
                driver: Driver::Policy.code(),
                ..scripted(alone.action(observation))
            },
        }
    }

    /// The last plan; none by drivers that do not plan.
    pub fn plan(&self) -> Option<&Plan> {
        match &self.kind {
            Loaded::Expert(stack) => Some(stack.last_plan()),
            Loaded::Lane | Loaded::Idm(_) | Loaded::Policy(_) => None,
        }
    }

    /// How long each plan took, us; empty for drivers that do not plan.
    pub fn planning_us(&self) -> &Histogram<u64> {
        &self.planning_us
    }

    /// The planning times since the last call, us; `None` without any.
    pub fn take_planning_us(&mut self) -> Option<Histogram<u64>> {
        (!self.planning_us.is_empty())
            .then(|| std::mem::replace(&mut self.planning_us, planning_histogram()))
    }
}

/// The bytes of a regular file.
fn read(file: &str) -> std::io::Result<Vec<u8>> {
    #[cfg(feature = "wire")]
    shm_config::file::regular(file.as_ref())?;
    std::fs::read(file)
}

/// A histogram of planning times, us.
pub fn planning_histogram() -> Histogram<u64> {
    // The bounds are constants that the library accepts.
    Histogram::new_with_bounds(1, PLANNING_MAX_US, 3).expect("valid bounds")
}

impl PolicyAlone {
    /// The policy's action, clamped; the brake where it has none.
    fn action(&mut self, observation: &Observation) -> Action {
        let mut motion = [MOTION_AT_REST; MOTION_FEATURES];
        if self.policy.takes_motion() {
            self.tracker.follow(observation);
            motion = self.tracker.motion();
        }
        let seen = (observation, &motion);
        let action = controller::ask(&mut *self.policy, seen, &mut self.features);
        let action = action.filter(|action| action.is_finite());
        action.map_or(Action::BRAKE, |action| action.clamped())
    }
}
