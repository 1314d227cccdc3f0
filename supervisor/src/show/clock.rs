//! The word of a run's clock.

use shm_config::config::Config;

/// The word of a run's clock that nothing can be late on.
pub const LOCKSTEP: &str = "lockstep";

/// The word of a run's clock.
pub fn clock_word(config: &Config) -> &'static str {
    match config.run.is_lockstep() {
        true => LOCKSTEP,
        false => "real time",
    }
}
