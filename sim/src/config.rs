//! The configuration of a world's episodes. The defaults are the paper's experiment.

use serde::{Deserialize, Serialize};
use vehicle::{InvalidVehicle, Scanner, Vehicle};

use crate::map::{BlockPlan, MapConfig, MapError};
use crate::spawn::{ScenarioConfig, ScenarioError};

/// Whether leaving the edges of the route's current road ends an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OutOfRoute {
    /// It ends the episode, as in the experiment.
    Ends,
    /// It does not; only sidewalks and the end of all lanes do.
    Continues,
}

/// The configuration of a world's episodes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldConfig {
    /// Number of random blocks after the first one.
    pub blocks: usize,
    /// Blocks in order, such as `SCrRXTO`, instead of random ones; empty for random.
    pub block_sequence: String,
    /// Lanes in one direction.
    pub lane_count: usize,
    /// Width of a lane, m.
    pub lane_width_m: f64,
    /// Length of the first block, m.
    pub exit_length_m: f64,
    /// Vehicles per ten metres of lane.
    pub traffic_density: f64,
    /// Probability of an obstacle on a block that may have one.
    pub accident_probability: f64,
    /// Whether each episode draws its own lanes, blocks, density and probability
    /// ([`ScenarioConfig::of_seed`]).
    pub varied: bool,
    /// Ticks after which an episode ends.
    pub horizon_steps: u64,
    /// The ego's car.
    pub vehicle: Vehicle,
    /// The ego's scanner; one of no beams sees nothing.
    pub scanner: Scanner,
    /// What leaving the route means.
    pub out_of_route: OutOfRoute,
}

impl Default for WorldConfig {
    fn default() -> WorldConfig {
        let scenario = ScenarioConfig::default();
        WorldConfig {
            blocks: scenario.map.blocks.len(),
            block_sequence: String::new(),
            lane_count: scenario.map.lane_count,
            lane_width_m: scenario.map.lane_width_m,
            exit_length_m: scenario.map.exit_length_m,
            traffic_density: scenario.traffic_density,
            accident_probability: scenario.accident_probability,
            varied: scenario.varied,
            horizon_steps: 1500,
            vehicle: Vehicle::default(),
            scanner: Scanner::default(),
            out_of_route: OutOfRoute::Ends,
        }
    }
}

/// Why there is no world, or no episode for a seed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum WorldError {
    /// There is no scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A number of the ego's car that no car has.
    #[error("vehicle.{0}")]
    Vehicle(InvalidVehicle),
    /// A number of the ego's scanner that no scanner has, or no message can carry.
    #[error("scanner.{0}")]
    Scanner(InvalidVehicle),
    /// An episode needs at least one tick.
    #[error("horizon_steps = 0: an episode needs at least one tick")]
    Horizon,
    /// A thread of a batch has died.
    #[error("a thread of the batch has panicked: make a new batch")]
    DeadThread,
}

impl From<MapError> for WorldError {
    fn from(error: MapError) -> WorldError {
        WorldError::Scenario(error.into())
    }
}

impl WorldConfig {
    /// The configuration of the scenario generator.
    ///
    /// # Errors
    /// [`WorldError`] if a block letter is unknown, or if car, scanner or
    /// horizon are out of range; the rest is checked when an episode begins.
    pub fn scenario(&self) -> Result<ScenarioConfig, WorldError> {
        self.vehicle.validated().map_err(WorldError::Vehicle)?;
        let scanner = Scanner {
            beams: self.scanner.beams.max(1),
            ..self.scanner
        };
        scanner.validated().map_err(WorldError::Scanner)?;
        if self.horizon_steps == 0 {
            return Err(WorldError::Horizon);
        }
        let blocks = match self.block_sequence.as_str() {
            "" => BlockPlan::Random(self.blocks),
            letters => BlockPlan::parse(letters)?,
        };
        Ok(ScenarioConfig {
            map: MapConfig {
                blocks,
                lane_count: self.lane_count,
                lane_width_m: self.lane_width_m,
                exit_length_m: self.exit_length_m,
            },
            traffic_density: self.traffic_density,
            accident_probability: self.accident_probability,
            varied: self.varied,
            ..ScenarioConfig::default()
        })
    }
}
