//! The small training of the tests of actors.

use shm_config::Instant;
use shm_config::config::{Algorithm, Config, GateMode, planner::Method};

/// Steps of a block.
pub const BLOCK: u64 = 120;

/// Its configuration: episodes of 40 ticks, and nets that learn in milliseconds.
pub fn config() -> Config {
    let mut config = Config::default();
    config.gate.mode = GateMode::Rules;
    config.planner.method = Method::Informed;
    config.world.horizon_ticks = 40;
    (config.run.seed, config.run.seeds, config.run.shuffle) = (100, 50, 1);
    config.learner.algorithm = Algorithm::HgDagger;
    config.learner.block_steps = BLOCK as u32;
    (config.learner.updates, config.learner.batch) = (3, 16);
    config.learner.hidden = 16;
    config
}

#[allow(clippy::disallowed_methods)] // a test is an entry point
pub fn clock() -> Instant {
    shm_config::time::monotonic()
}
