//! The configuration of a world's episodes. The defaults are the paper's experiment.

use serde::{Deserialize, Serialize};
use shm_config::message::BEAMS_MAX;

use crate::map::{BlockPlan, MapConfig, MapError};
use crate::spawn::{ScenarioConfig, ScenarioError};

/// Least and greatest range of a beam, m, that a message can carry.
const LIDAR_RANGES_M: std::ops::RangeInclusive<f64> = 0.1..=1000.0;

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
    /// Ticks after which an episode ends.
    pub horizon_steps: u64,
    /// Lidar beams.
    pub beam_count: usize,
    /// Reach of a beam, m.
    pub lidar_range_m: f64,
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
            horizon_steps: 1500,
            beam_count: 240,
            lidar_range_m: 50.0,
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
    /// More beams than a message carries.
    #[error("beam_count = {0}: an observation carries at most {BEAMS_MAX}")]
    BeamCount(usize),
    /// A reach that no message can carry.
    #[error("lidar_range_m = {0}: it must be {LIDAR_RANGES_M:?} m")]
    LidarRange(f64),
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
    /// [`WorldError`] if a block letter is unknown, or if beams or horizon are
    /// out of range; the rest is checked when an episode begins.
    pub fn scenario(&self) -> Result<ScenarioConfig, WorldError> {
        if self.beam_count > BEAMS_MAX {
            return Err(WorldError::BeamCount(self.beam_count));
        }
        if !LIDAR_RANGES_M.contains(&self.lidar_range_m) {
            return Err(WorldError::LidarRange(self.lidar_range_m));
        }
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
        })
    }
}
