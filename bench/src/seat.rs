//! Who sits at the wheel of an episode.

use anyhow::Context;
use controller::{Controller, Inputs, Intent, Policy, PolicySlot, Terms};
use hdrhistogram::Histogram;
use planner::Planner;
use shm_config::Instant;
use shm_config::config::planner::Method;
use shm_config::config::{Config, GateMode};
use shm_config::file::regular;
use shm_config::message::{BEAMS_MAX, Bend, Command, Driver, Header, Observation, Plan, Reason};
use sim::World;
use sim::idm::Idm;
use vehicle::Action;

use crate::Clock;

/// Steps between two changes of lane of MetaDrive's driver; his timer begins
/// anywhere below (`LANE_CHANGE_FREQ`).
const LANE_CHANGE_STEPS: u64 = 50;
/// Longest planning time that is told apart, us: ten periods.
const PLANNING_MAX_US: u64 = 1_000_000;

/// Straight on, brakes full.
const BRAKE: Action = Action {
    steer: 0.0,
    pedal: -1.0,
};

/// The drivers that can be asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DriverKind {
    /// Planner and controller of this stack, with the judge in the tick; plans
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
    /// MetaDrive's driver of the other cars, which sees everything.
    Idm,
    /// The policy of this file alone: no expert, no judge, no brake beside it.
    /// The name lives as long as the program, as all of its arguments do.
    Policy(&'static str),
}

/// Those with a name of their own.
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

    /// To be part of a file's name.
    pub fn file_word(self) -> &'static str {
        let path = std::path::Path::new(self.word());
        path.file_stem()
            .and_then(|stem| stem.to_str())
            .unwrap_or("policy")
    }

    /// The planning method it stands for; none when the configuration says it,
    /// or nothing is planned.
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

/// A driver at the wheel.
pub struct Seat {
    config: Config,
    clock: Clock,
    planning_us: Histogram<u64>,
    driver: Seated,
}

enum Seated {
    Expert(Box<Stack>),
    Lane,
    Idm(Idm),
    Policy(Box<Alone>),
}

/// A policy with nobody beside it, and the room for its features.
struct Alone {
    policy: Box<dyn Policy>,
    features: [f32; 19 + BEAMS_MAX],
}

/// Planner and controller without their processes.
struct Stack {
    planner: Planner,
    controller: Controller,
    plan: Plan,
    inputs: Inputs,
}

impl Seat {
    /// A driver of this kind. The configuration is that of a run; its gate is
    /// always the expert's, as with `./vlaps up --gate expert`.
    ///
    /// # Errors
    /// When the planner's configuration is out of range, or the policy's file is
    /// refused.
    pub fn new(kind: DriverKind, config: &Config, clock: Clock) -> anyhow::Result<Seat> {
        let mut config = kind.configure(config);
        config.gate.mode = GateMode::Expert;
        // Nothing may depend on how fast this machine is now.
        config.run.clock = shm_config::config::Clock::Lockstep;
        let driver = match kind {
            DriverKind::Expert
            | DriverKind::RrtStar
            | DriverKind::Informed
            | DriverKind::Kinodynamic
            | DriverKind::Mpc => Seated::Expert(Box::new(Stack {
                planner: Planner::new(&config)?,
                controller: Controller::new(config.clone(), PolicySlot::new(None)),
                plan: Plan::default(),
                inputs: Inputs::default(),
            })),
            DriverKind::Lane => Seated::Lane,
            DriverKind::Idm => Seated::Idm(Idm::new(0, 0)),
            DriverKind::Policy(file) => {
                let read = || {
                    regular(file.as_ref())?;
                    std::fs::read(file)
                };
                let bytes = read().with_context(|| file.to_string())?;
                let terms = Terms {
                    config: &config,
                    version: 1,
                    clock,
                };
                let policy = controller::build(&bytes, &terms).with_context(|| file.to_string())?;
                Seated::Policy(Box::new(Alone {
                    policy,
                    features: [0.0; 19 + BEAMS_MAX],
                }))
            }
        };
        Ok(Seat {
            config,
            clock,
            planning_us: planning_histogram(),
            driver,
        })
    }

    /// Gets ready for the episode that has begun: nothing of the one before is
    /// left, so an episode depends on its seed alone.
    pub fn begin(&mut self, seed: u64) {
        match &mut self.driver {
            Seated::Expert(stack) => {
                stack.controller = Controller::new(self.config.clone(), PolicySlot::new(None));
                stack.planner.forget();
            }
            Seated::Lane | Seated::Policy(_) => {}
            Seated::Idm(idm) => {
                *idm = Idm::new((seed.wrapping_mul(31) % LANE_CHANGE_STEPS) as u32, seed);
            }
        }
    }

    /// The command for what is observed now in the built-in world.
    pub fn command(&mut self, observation: &Observation, world: &mut World) -> Command {
        self.steer(observation, |idm| world.advise(idm).clamped())
    }

    /// The command of a driver who sees the observation alone, in any world.
    /// MetaDrive's own driver sees nothing there, and brakes.
    pub fn answer(&mut self, observation: &Observation) -> Command {
        self.steer(observation, |_| BRAKE)
    }

    /// The command; `advise` asks MetaDrive's own driver.
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
        match &mut self.driver {
            Seated::Expert(stack) => {
                let begun = (self.clock)();
                stack.planner.plan(observation, &mut stack.plan);
                let planning_ns = (self.clock)().since_ns(begun);
                self.planning_us
                    .saturating_record(planning_ns.div_ceil(1000));
                stack.command(observation)
            }
            Seated::Lane => scripted(keep_lane(observation)),
            Seated::Idm(idm) => scripted(advise(idm)),
            Seated::Policy(alone) => Command {
                driver: Driver::Policy.code(),
                ..scripted(alone.action(observation))
            },
        }
    }

    /// The last plan; none by drivers that do not plan.
    pub fn plan(&self) -> Option<&Plan> {
        match &self.driver {
            Seated::Expert(stack) => Some(&stack.plan),
            Seated::Lane | Seated::Idm(_) | Seated::Policy(_) => None,
        }
    }

    /// How long each plan took, us; empty for drivers that do not plan.
    pub fn planning_us(&self) -> &Histogram<u64> {
        &self.planning_us
    }
}

/// Room for planning times.
pub fn planning_histogram() -> Histogram<u64> {
    // The bounds are constants that the library accepts; a test would not start
    // otherwise.
    Histogram::new_with_bounds(1, PLANNING_MAX_US, 3).expect("valid bounds")
}

impl Alone {
    /// The policy's action, clamped; the brake where it has none.
    fn action(&mut self, observation: &Observation) -> Action {
        let features = observation.features(&mut self.features);
        let action = features.and_then(|features| self.policy.infer(features));
        let action = action.filter(|action| action.is_finite());
        action.map_or(BRAKE, |action| action.clamped())
    }
}

impl Stack {
    /// The controller's tick, in the order of the processes in lockstep:
    /// observation, its plan, command.
    fn command(&mut self, observation: &Observation) -> Command {
        self.inputs.observation = Some(*observation);
        self.inputs.plan = Some(self.plan);
        let Header { tick, .. } = observation.header;
        let now: Instant = observation.header.taken();
        let step = self.controller.tick(&self.inputs, tick, now, Intent::Drive);
        step.command
    }
}

/// Speed of the lane keeper on a straight road, m/s.
const CRUISE_MPS: f64 = 8.0;
/// Sideways acceleration it takes a bend with, m/s².
const SIDEWAYS_MPS2: f64 = 3.0;
/// A bend counts from this far before its road, m.
const BEND_AHEAD_M: f64 = 12.0;
/// Half the width of the strip ahead in which it brakes for what it sees, m.
const STRIP_M: f64 = 1.3;
/// It stands this far behind what is ahead, from centre to return, m.
const STANDOFF_M: f64 = 5.0;
/// The deceleration it reckons with, m/s².
const BRAKE_MPS2: f64 = 3.0;

/// Keeps to its lane, slows down for bends and for what is straight ahead, and
/// never changes lanes. It sees the observation alone, so it drives in any
/// world that publishes one.
pub fn keep_lane(observation: &Observation) -> Action {
    let road = &observation.road;
    let mut speed_mps = CRUISE_MPS;
    let [here, next] = &observation.checkpoints;
    let to_next_m = here.x_body_m.hypot(here.y_body_m);
    for (checkpoint, near) in [(here, true), (next, to_next_m < BEND_AHEAD_M)] {
        if near && checkpoint.bend != Bend::Straight.code() {
            let bend_mps = (SIDEWAYS_MPS2 * checkpoint.bend_radius_m).sqrt();
            speed_mps = speed_mps.min(bend_mps);
        }
    }
    let room_m = (free_ahead_m(observation) - STANDOFF_M).max(0.0);
    speed_mps = speed_mps.min((2.0 * BRAKE_MPS2 * room_m).sqrt());
    Action {
        steer: -(0.8 * road.heading_rad + 0.12 * road.offset_m),
        pedal: 0.3 * (speed_mps - observation.ego.speed_mps),
    }
    .clamped()
}

/// Distance to the nearest return in the strip ahead, m; infinite when free.
fn free_ahead_m(observation: &Observation) -> f64 {
    let ranges_m = observation.ranges();
    let spacing_rad = std::f64::consts::TAU / ranges_m.len() as f64;
    let returns = ranges_m.iter().enumerate().filter_map(|(k, &range_m)| {
        if range_m >= observation.lidar_max_m {
            return None;
        }
        let (sin, cos) = (k as f64 * spacing_rad).sin_cos();
        let range_m = f64::from(range_m);
        (cos > 0.0 && (range_m * sin).abs() < STRIP_M).then_some(range_m * cos)
    });
    returns.fold(f64::INFINITY, f64::min)
}
