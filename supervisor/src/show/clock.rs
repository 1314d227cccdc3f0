//! The word of a run's clock.

use shm_config::config::Config;

/// The word of the lockstep clock, on which no tick can be late.
pub const LOCKSTEP: &str = "lockstep";

/// The word of a run's clock.
pub fn clock_word(config: &Config) -> &'static str {
    match config.run.is_lockstep() {
        true => LOCKSTEP,
        false => "real time",
    }
}
