//! Converts the sections of a run's configuration that a world obeys.

use shm_config::config::Config;

use crate::config::WorldConfig;

impl From<&Config> for WorldConfig {
    fn from(config: &Config) -> WorldConfig {
        let section = &config.world;
        WorldConfig {
            blocks: section.blocks as usize,
            block_sequence: section.sequence.clone(),
            lane_count: section.lanes as usize,
            lane_width_m: section.lane_width_m,
            traffic_density: section.traffic_density,
            accident_probability: section.accident_probability,
            varied: section.varied,
            horizon_steps: u64::from(section.horizon_ticks),
            vehicle: config.vehicle,
            scanner: config.scanner,
            ..WorldConfig::default()
        }
    }
}
