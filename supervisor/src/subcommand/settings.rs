//! The configuration as `./vlaps up` resolves it.

use std::ffi::OsString;
use std::path::Path;

use clap::Parser;
use shm_config::config::{Clock, Config, ConfigError};
use shm_config::secret;

use crate::arguments::{Arguments, Command};
use crate::cli::failure::Failure;
use crate::commands::up::settings::resolve;

/// Decisions per second; a tick of the built-in world.
const DECISION_HZ: f64 = 10.0;

/// The configuration of `./vlaps up` with these arguments.
fn of_up(words: impl IntoIterator<Item = OsString>) -> Result<Config, Failure> {
    let words = [OsString::from("vlaps"), "up".into()]
        .into_iter()
        .chain(words);
    let arguments =
        Arguments::try_parse_from(words).map_err(|error| Failure::Usage(error.to_string()))?;
    match &arguments.command {
        Command::Up(up) => {
            let config = resolve(up)?;
            // When other threads run, such as that of a progress bar, the key stays in
            // the environment; the supervisor that this program starts removes it
            // there.
            let _ = secret::take_named(&config.vlm.key_env);
            Ok(config)
        }
        _ => Err(Failure::Usage("no configuration".into())),
    }
}

/// The configuration of a set that is started with these arguments in its own folder,
/// which has no `vlaps.toml`.
///
/// # Errors
/// When an option or an override is wrong, or the system gives no file.
pub fn of_set(words: impl IntoIterator<Item = impl Into<OsString>>) -> anyhow::Result<Config> {
    let empty = tempfile::NamedTempFile::new()?;
    let none = [OsString::from("--config"), empty.path().into()];
    let config = of_up(words.into_iter().map(Into::into).chain(none));
    Ok(config.map_err(|failure| match failure {
        // The temporary file is not the user's.
        Failure::Config(ConfigError::OutOfRange { error, .. }) => Failure::Usage(error.to_string()),
        other => other,
    })?)
}

/// The configuration of a recorded run with overrides; `text` is its own, TOML.
///
/// # Errors
/// When an override is wrong, or the system gives no file.
pub fn changed(text: &str, overrides: &[String]) -> anyhow::Result<Config> {
    let file = tempfile::NamedTempFile::new()?;
    std::fs::write(file.path(), text)?;
    let mut words = vec![OsString::from("--config"), file.path().into()];
    for text in overrides {
        words.extend(["--set".into(), text.into()]);
    }
    // The temporary file is not the user's.
    let own = file.path().display().to_string();
    Ok(of_up(words).map_err(|failure| match failure {
        Failure::Config(ConfigError::OutOfRange { error, .. }) => Failure::Usage(error.to_string()),
        Failure::Config(error) => Failure::Usage(error.to_string().replace(&own, "configuration")),
        other => other,
    })?)
}

/// Refuses overrides of keys that a command sets itself. Each key comes with its
/// option, or with an empty text if it has none.
///
/// # Errors
/// The first such key, and what to do.
pub fn refuse_own(overrides: &[String], own: &[(&str, &str)]) -> Result<(), Failure> {
    for text in overrides {
        let key = text.split('=').next().unwrap_or_default().trim();
        // A whole section given as one value contains its keys.
        let is_meant = |(own, _): &&(&str, &str)| {
            *own == key
                || own
                    .strip_prefix(key)
                    .is_some_and(|rest| rest.starts_with('.'))
        };
        if let Some((own, option)) = own.iter().find(is_meant) {
            let instead = match *option {
                "" => "leave it out".into(),
                option => format!("use {option}"),
            };
            return Err(Failure::Usage(format!(
                "--set {text}: {own} is set by this command itself; {instead}"
            )));
        }
    }
    Ok(())
}

/// The configuration of `./vlaps up --config FILE --vehicle FILE --set KEY=VALUE ...`; the
/// files in that order. It uses the
/// arguments of that command, so that file, defaults and overrides have the same
/// meaning.
///
/// # Errors
/// When the file or an override is wrong; the error names the one that is.
pub fn config(files: [Option<&Path>; 2], overrides: &[String]) -> Result<Config, Failure> {
    let mut words: Vec<OsString> = Vec::new();
    for (option, file) in ["--config", "--vehicle"].into_iter().zip(files) {
        words.extend(
            file.into_iter()
                .flat_map(|file| [option.into(), file.into()]),
        );
    }
    for text in overrides {
        words.extend(["--set".into(), text.into()]);
    }
    let mut config = of_up(words)?;
    for (key, program) in [
        ("programs.world", &config.programs.world),
        ("programs.planner", &config.programs.planner),
        ("programs.gate", &config.programs.gate),
        ("link.judge", &config.link.judge),
        ("link.learner", &config.link.learner),
    ] {
        if !program.is_empty() {
            return Err(Failure::Usage(format!(
                "{key} = {program:?}: this command drives with the programs of the build; your \
                 program drives in ./vlaps up"
            )));
        }
    }
    // The result must not depend on the speed of this machine.
    config.run.clock = Clock::Lockstep;
    let rates = [
        ("run.rate_hz", config.run.rate_hz),
        ("world.rate_hz", config.world.rate_hz),
        ("planner.rate_hz", config.planner.rate_hz),
    ];
    for (key, rate_hz) in rates {
        // 0 means the run's rate.
        if rate_hz != 0.0 && (rate_hz - DECISION_HZ).abs() > 1e-9 {
            return Err(Failure::Usage(format!(
                "{key} = {rate_hz}: episodes are driven here at {DECISION_HZ} Hz, \
                 the rate of the car's physics; leave the key out, or override it with \
                 --set {key}={DECISION_HZ}"
            )));
        }
    }
    Ok(config)
}

/// The key of an override, `KEY=VALUE`.
pub fn key(text: &str) -> &str {
    text.split('=').next().unwrap_or_default().trim()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_is_configured_by_its_words_alone() {
        let words = |rate: &str| ["--rate", rate, "--set", "planner.rate_hz=20"].map(String::from);
        let config = of_set(words("100")).expect("a configuration");
        assert_eq!(
            (config.run.rate_hz, config.planner_rate_hz()),
            (100.0, 20.0)
        );
        for rate in ["2000", "0", "nan", "-5", "15"] {
            let error = of_set(words(rate)).expect_err(rate);
            let text = error.to_string();
            assert!(text.starts_with("run.rate_hz = "), "{rate}: {text}");
            assert!(error.downcast_ref::<Failure>().is_some(), "{rate}");
        }
    }

    #[test]
    fn the_rate_of_a_vehicle_can_be_overridden_where_episodes_are_driven() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("car.toml");
        std::fs::write(&file, "[vehicle]\n\n[run]\nrate_hz = 20.0\n").expect("a vehicle file");
        let told = config([None, Some(&file)], &[]).expect_err("another rate");
        let remedy = "run.rate_hz=10";
        assert!(told.to_string().ends_with(remedy), "{told}");
        let config = config([None, Some(&file)], &[remedy.into()]).expect("a configuration");
        assert_eq!(config.run.rate_hz, 10.0);
    }

    #[test]
    fn keys_that_a_command_sets_itself_cannot_be_overridden() {
        let own = [("run.rate_hz", "--rate"), ("run.name", "")];
        let told = |text: &str| refuse_own(&[text.into()], &own).map_err(|error| error.to_string());
        let refused = |text: &str| told(text).expect_err(text);
        assert!(refused("run.rate_hz=50").ends_with("; use --rate"));
        assert!(refused(" run.name = x").ends_with("; leave it out"));
        assert!(refused("run={rate_hz=50}").contains("run.rate_hz"));
        for other in [
            "run.rate=50",
            "planner.rate_hz=20",
            "run.rate_hz_max=1",
            "runs=1",
        ] {
            assert_eq!(told(other), Ok(()), "{other}");
        }
    }
}
