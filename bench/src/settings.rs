//! The configuration, exactly as `./vlaps up` resolves it.

use std::path::Path;

use clap::Parser;
use shm_config::config::{Clock, Config};
use supervisor::arguments::{Arguments, Command};
use supervisor::failure::Failure;
use supervisor::settings::resolve;

/// Ticks of the car's physics in a second.
const PHYSICS_HZ: f64 = 10.0;

/// The configuration of `./vlaps up --config FILE --set KEY=VALUE ...`. It is
/// asked for through that command's own arguments, so that file, defaults and
/// overrides mean the same here.
///
/// # Errors
/// When the file or an override is wrong; the error names the one that is.
pub fn config(file: Option<&Path>, overrides: &[String]) -> Result<Config, Failure> {
    let mut words: Vec<std::ffi::OsString> = vec!["vlaps".into(), "up".into()];
    if let Some(file) = file {
        words.extend(["--config".into(), file.into()]);
    }
    for text in overrides {
        words.extend(["--set".into(), text.into()]);
    }
    let arguments =
        Arguments::try_parse_from(words).map_err(|error| Failure::Usage(error.to_string()))?;
    let Command::Up(up) = &arguments.command else {
        return Err(Failure::Usage("no configuration".into()));
    };
    let mut config = resolve(up)?;
    // Nothing here may depend on how fast this machine is now.
    config.run.clock = Clock::Lockstep;
    let rates = [
        ("run.rate_hz", config.run.rate_hz),
        ("world.rate_hz", config.world.rate_hz),
        ("planner.rate_hz", config.planner.rate_hz),
    ];
    for (key, rate_hz) in rates {
        // 0 means the run's rate.
        if rate_hz != 0.0 && (rate_hz - PHYSICS_HZ).abs() > 1e-9 {
            return Err(Failure::Usage(format!(
                "{key} = {rate_hz}: episodes are driven here at {PHYSICS_HZ} Hz, \
                 the rate of the car's physics; leave the key out"
            )));
        }
    }
    Ok(config)
}

/// The key of an override, `KEY=VALUE`.
pub fn key(text: &str) -> &str {
    text.split('=').next().unwrap_or_default().trim()
}
