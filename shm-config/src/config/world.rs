use serde::{Deserialize, Serialize};
use vehicle::{Scanner, Vehicle};

use super::{OutOfRange, in_range};

/// One row for each simulator: its variant, and its word in files and on the command line.
macro_rules! simulators {
    ($($(#[doc = $about:literal])* $name:ident = $word:literal,)*) => {
        /// The simulator of the world.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
        pub enum Simulator {
            $($(#[doc = $about])* #[serde(rename = $word)] $name,)*
        }

        impl Simulator {
            /// All of them, the built-in world first.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// Its word in files and on the command line.
            pub fn word(self) -> &'static str {
                match self {
                    $(Self::$name => $word,)*
                }
            }
        }
    };
}

simulators! {
    /// The built-in world.
    BuiltIn = "sim",
    /// The real MetaDrive, as `./vlaps setup metadrive` installs it.
    MetaDrive = "metadrive",
    /// ir-sim, as `./vlaps setup ir-sim` installs it.
    IrSim = "ir-sim",
    /// The F1TENTH gym, as `./vlaps setup f1tenth` installs it.
    F1tenth = "f1tenth",
    /// CommonRoad scenarios, as `./vlaps setup commonroad` installs what drives them.
    CommonRoad = "commonroad",
}

/// The world; the defaults are the paper's experiment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct World {
    /// The simulator: sim, the built-in world; metadrive, the real one; ir-sim; f1tenth;
    /// or commonroad.
    pub simulator: Simulator,
    /// Instants of the world per second, at each of which it moves and publishes: a
    /// multiple of run.rate_hz up to 1000; 0 for the same rate. At any rate, traffic
    /// and rules decide at 10 Hz and the car's physics has sub-steps of 0.02 s; above
    /// 50 Hz, poses between two sub-steps are interpolated.
    pub rate_hz: f64,
    /// Random blocks after the first straight.
    pub blocks: u32,
    /// Block sequence such as "SCrRXTO" in place of random blocks; empty for none.
    pub sequence: String,
    /// Lanes in each direction.
    pub lanes: u32,
    /// Width of a lane, m.
    pub lane_width_m: f64,
    /// Vehicles per 10 m of spawn lane.
    pub traffic_density: f64,
    /// Probability of an obstacle on a block.
    pub accident_probability: f64,
    /// In the built-in world: whether each episode has its own number of lanes (2 to 4) and,
    /// without a sequence, of blocks (1 to 7), traffic density (0 to 0.3), probability of
    /// an obstacle (0 to 1), speed of the traffic (20 to 40 km/h), share of lost returns (0 to
    /// 0.05) and deviation of ranges (0 to 0.1 m), drawn from its seed.
    pub varied: bool,
    /// Ticks after which an episode ends. Those of the built-in world take 0.1 s at each rate.
    pub horizon_ticks: u32,
}

impl Default for World {
    fn default() -> Self {
        Self {
            simulator: Simulator::BuiltIn,
            rate_hz: 0.0,
            blocks: 3,
            sequence: String::new(),
            lanes: 3,
            lane_width_m: 3.5,
            traffic_density: 0.06,
            accident_probability: 0.8,
            varied: false,
            horizon_ticks: 1500,
        }
    }
}

impl World {
    /// Refuses what the real MetaDrive does not obey. Planner and safety check compute
    /// with `[vehicle]` and `[scanner]`, and would otherwise plan for another car than
    /// the one that drives.
    fn check_obeys(&self, vehicle: &Vehicle, scanner: &Scanner) -> Result<(), OutOfRange> {
        if self.simulator != Simulator::MetaDrive {
            return Ok(());
        }
        let (car, own) = (Vehicle::default(), Scanner::default());
        let keys = [
            ("vehicle.length_m", vehicle.length_m, car.length_m),
            ("vehicle.width_m", vehicle.width_m, car.width_m),
            ("vehicle.wheelbase_m", vehicle.wheelbase_m, car.wheelbase_m),
            (
                "vehicle.max_steer_deg",
                vehicle.max_steer_deg,
                car.max_steer_deg,
            ),
            (
                "vehicle.max_accel_mps2",
                vehicle.max_accel_mps2,
                car.max_accel_mps2,
            ),
            (
                "vehicle.max_brake_mps2",
                vehicle.max_brake_mps2,
                car.max_brake_mps2,
            ),
            (
                "vehicle.max_speed_mps",
                vehicle.max_speed_mps,
                car.max_speed_mps,
            ),
            ("vehicle.delay_ms", vehicle.delay_ms, car.delay_ms),
            (
                "scanner.field_of_view_deg",
                scanner.field_of_view_deg,
                own.field_of_view_deg,
            ),
            ("scanner.x_m", scanner.x_m, own.x_m),
            ("scanner.y_m", scanner.y_m, own.y_m),
            ("scanner.heading_deg", scanner.heading_deg, own.heading_deg),
            (
                "scanner.drop_probability",
                scanner.drop_probability,
                own.drop_probability,
            ),
        ];
        match keys.into_iter().find(|(_, given, own)| given != own) {
            None => Ok(()),
            Some((key, given, own)) => Err(OutOfRange {
                key: key.into(),
                value: given.to_string(),
                expected: format!(
                    "{own}, the default: MetaDrive drives its own car, it does not obey \
                     [vehicle] and [scanner]; the built-in world does"
                ),
            }),
        }
    }

    pub(super) fn check(&self, vehicle: &Vehicle, scanner: &Scanner) -> Result<(), OutOfRange> {
        self.check_obeys(vehicle, scanner)?;
        in_range("world.blocks", self.blocks, 1..=30)?;
        if self.varied && self.simulator != Simulator::BuiltIn {
            return Err(OutOfRange {
                key: "world.varied".into(),
                value: "true".into(),
                expected: "false: only the built-in world draws episodes of many kinds".into(),
            });
        }
        if let Some(letter) = self.sequence.chars().find(|c| !"SCrRXTO".contains(*c)) {
            return Err(OutOfRange {
                key: "world.sequence".into(),
                value: format!("{:?}", self.sequence),
                expected: format!("made of the letters S C r R X T O, not '{letter}'"),
            });
        }
        in_range("world.sequence's length", self.sequence.len(), 0..=30)?;
        in_range("world.lanes", self.lanes, 1..=6)?;
        in_range("world.lane_width_m", self.lane_width_m, 2.5..=6.0)?;
        in_range("world.traffic_density", self.traffic_density, 0.0..=1.0)?;
        in_range(
            "world.accident_probability",
            self.accident_probability,
            0.0..=1.0,
        )?;
        in_range("world.horizon_ticks", self.horizon_ticks, 1..=10_000_000)
    }
}
