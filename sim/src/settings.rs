//! Converts the `world` section of a run's configuration.

use shm_config::config;

use crate::config::WorldConfig;

impl From<&config::World> for WorldConfig {
    fn from(section: &config::World) -> WorldConfig {
        WorldConfig {
            blocks: section.blocks as usize,
            block_sequence: section.sequence.clone(),
            lane_count: section.lanes as usize,
            lane_width_m: section.lane_width_m,
            traffic_density: section.traffic_density,
            accident_probability: section.accident_probability,
            horizon_steps: u64::from(section.horizon_ticks),
            beam_count: section.beams as usize,
            lidar_range_m: section.lidar_m,
            ..WorldConfig::default()
        }
    }
}
