//! The command line of `vlaps-ros`.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use shm_config::run::RunName;
use shm_config::secret;

use crate::bridge;
use crate::settings::Settings;

/// The help text.
pub const HELP: &str =
    "Publish a running set as ROS 2 topics over Zenoh, as one reader more, until the \
set ends or Ctrl-C.

Usage: vlaps-ros RUN

The environment variable VLAPS_ROS names a file of settings: docs/ros.md.
Exit code 2: no such run, or the settings are wrong.";

/// Publishes the run of this name until it ends or a stop is requested; what was sent.
///
/// # Errors
/// One line: the environment, the name, the settings or the run.
pub fn publish(word: &str) -> Result<bridge::Sent, String> {
    // It needs no key, and talks to a network.
    secret::take()
        .map_err(|error| format!("cannot take the keys out of the environment: {error}"))?;
    let name: RunName = word.parse().map_err(|error| format!("{error}"))?;
    let settings = Settings::load()?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        let registered = signal_hook::flag::register(signal, stop.clone());
        registered.map_err(|error| format!("cannot handle signals: {error}"))?;
    }
    bridge::run(&name, &settings, &stop)
}
