//! File, options and overrides make one checked configuration.

use std::path::{Path, PathBuf};

use shm_config::config::planner::Method;
use shm_config::config::{
    Config, ConfigError, GateMode, from_toml, is_address, load, text_of, vehicle_of, with_vehicle,
};
use shm_config::{file, shortened};
use toml::{Table, Value};

use crate::cli::failure::Failure;
use crate::commands::up::arguments::{GateChoice, Up, UpWorld};
use crate::setup::own_programs;

/// Read from the current folder if it exists and no other file is named.
pub const DEFAULT_FILE: &str = "vlaps.toml";

/// One key with its new value, and the option it came by.
struct Override {
    origin: String,
    key: String,
    value: Value,
}

/// The configuration of an `up`.
///
/// # Errors
/// When the file or an option is wrong; the error names the one that is.
pub fn resolve(arguments: &Up) -> Result<Config, Failure> {
    let (mut table, origin) = match file_of(arguments) {
        Some(path) => (read(&path)?, path.display().to_string()),
        None => (Table::new(), "the command line".into()),
    };
    if let Some(file) = &arguments.vehicle {
        table = with_vehicle(table, vehicle_of(file)?);
    }
    let text_at = |table: &Table, key: &str| Some(lookup(table, key)?.as_str()?.to_string());
    // A file printed by `./vlaps config` names both; the folder must still follow the
    // name, or two runs would share one.
    let own_folder = text_at(&table, "run.name").unwrap_or(Config::default().run.name);
    let own_folder = format!("runs/{own_folder}");
    let folder_given = text_at(&table, "run.folder").is_some_and(|folder| folder != own_folder);
    if arguments.lockstep && arguments.gate == Some(GateChoice::Human) {
        let message = "--gate human needs real time; drop --lockstep";
        return Err(Failure::Usage(message.into()));
    }
    let overrides = overrides_of(arguments)?;
    for change in &overrides {
        check_alone(change)?;
        insert(&mut table, &change.key, change.value.clone());
    }
    let name = text_at(&table, "run.name");
    let folder_given = folder_given || overrides.iter().any(|change| change.key == "run.folder");
    if let (Some(name), false) = (name, folder_given) {
        insert(&mut table, "run.folder", format!("runs/{name}").into());
    }
    let named = match overrides.is_empty() && arguments.vehicle.is_none() {
        true => origin,
        false => format!("{origin}, with the options given"),
    };
    from_toml(&table.to_string(), &named).map_err(|error| match error {
        // The option that gave the value, if one did.
        ConfigError::OutOfRange { origin, error } => {
            let mut given = overrides.iter().rev();
            let option = given.find(|change| change.key == error.key);
            let origin = option.map_or(origin, |change| change.origin.clone());
            ConfigError::OutOfRange { origin, error }.into()
        }
        other => other.into(),
    })
}

fn file_of(arguments: &Up) -> Option<PathBuf> {
    let default = Path::new(DEFAULT_FILE);
    arguments
        .config
        .clone()
        // Any kind of file: one that cannot be read is an error.
        .or_else(|| default.symlink_metadata().is_ok().then(|| default.into()))
}

/// The file's own table. Its keys, types and syntax are checked here, where line
/// numbers are those of the file. Ranges are checked after the overrides, which may
/// move a value back into a range that depends on another key.
fn read(path: &Path) -> Result<Table, Failure> {
    match load(path) {
        Ok(_) | Err(ConfigError::OutOfRange { .. }) => {}
        Err(error) => return Err(error.into()),
    }
    text_of(path)?
        .parse()
        .map_err(|error| Failure::Usage(format!("{}: {error}", path.display())))
}

/// An override as errors show it. The value of an address is not shown, because it may
/// hold a key.
fn shown<'a>(key: &'a str, text: &'a str) -> &'a str {
    match key {
        "vlm.server" => key,
        _ => text,
    }
}

fn overrides_of(arguments: &Up) -> Result<Vec<Override>, Failure> {
    let mut overrides = Vec::new();
    let mut push = |origin: &str, key: &str, value: Option<Value>| {
        overrides.extend(value.map(|value| Override {
            origin: origin.into(),
            key: key.into(),
            value,
        }));
    };
    let integer = |number: i64| Value::Integer(number);
    // The option's parser admits no seed above the largest TOML integer.
    let seed = arguments.seed.map(|seed| integer(seed as i64));
    push("--seed", "run.seed", seed);
    let episodes = arguments.episodes.map(|count| integer(i64::from(count)));
    push("--episodes", "run.episodes", episodes);
    let duration = arguments.duration.map(Value::Float);
    push("--duration", "run.duration_s", duration);
    // The paper pauses the world for each question.
    let is_lockstep = arguments.lockstep || arguments.gate == Some(GateChoice::Paper);
    let clock = is_lockstep.then(|| Value::from("lockstep"));
    push("--lockstep", "run.clock", clock);
    let driver = written("--driver", arguments.driver.map(Method::from))?;
    push("--driver", "planner.method", driver);
    let gate = written("--gate", arguments.gate.map(GateMode::from))?;
    push("--gate", "gate.mode", gate);
    for (option, key, value) in programs_of(arguments)? {
        push(option, key, Some(value));
    }
    let policy = arguments.policy.as_deref().map(policy_file).transpose()?;
    push("--policy", "policy.file", policy.map(Value::from));
    push("--rate", "run.rate_hz", arguments.rate.map(Value::Float));
    let name = arguments.run.as_ref().map(|name| name.to_string().into());
    push("--run", "run.name", name);
    let ordinary = arguments.no_realtime.then_some(Value::Boolean(false));
    push("--no-realtime", "supervisor.realtime", ordinary);
    for (option, key, value) in recording_of(arguments)? {
        push(option, key, Some(value));
    }
    for text in &arguments.overrides {
        let Some((key, value)) = text.split_once('=') else {
            return Err(Failure::Usage(format!(
                "--set {}: write it as KEY=VALUE, such as --set gate.period_s=5",
                shortened(text)
            )));
        };
        let value = value_of(value.trim());
        push(
            &format!("--set {}", shortened(shown(key.trim(), text))),
            key.trim(),
            Some(value),
        );
    }
    Ok(overrides)
}

/// The value of an option as the configuration writes it.
fn written(option: &str, value: Option<impl serde::Serialize>) -> Result<Option<Value>, Failure> {
    let value = value.map(Value::try_from).transpose();
    value.map_err(|error| Failure::Usage(format!("{option}: {error}")))
}

/// The option, key and value of what the options of world, planner and judge set. An
/// option also ends what the file says of the other choice.
fn programs_of(arguments: &Up) -> Result<Vec<(&'static str, &'static str, Value)>, Failure> {
    let mut keys = Vec::new();
    let world = "--world";
    match &arguments.world {
        None => {}
        Some(UpWorld::Simulator(choice)) => {
            let simulator = written(world, Some(*choice))?;
            keys.extend(simulator.map(|simulator| (world, "world.simulator", simulator)));
            keys.push((world, "programs.world", "".into()));
        }
        Some(UpWorld::Program(path)) => {
            let path = own_programs::of_option(world, path)?;
            keys.push((world, "programs.world", path.into()));
        }
    }
    match &arguments.planner {
        Some(path) => {
            let path = own_programs::of_option("--planner", path)?;
            keys.push(("--planner", "programs.planner", path.into()));
        }
        None if arguments.driver.is_some() => {
            keys.push(("--driver", "programs.planner", "".into()));
        }
        None => {}
    }
    let address = arguments.judge.as_deref().and_then(address_of);
    match &arguments.judge {
        Some(_) if address.is_some() => {
            keys.push(("--judge", "link.judge", address.unwrap_or_default().into()));
            keys.push(("--judge", "programs.gate", "".into()));
        }
        Some(path) => {
            keys.push(("--judge", "link.judge", "".into()));
            let path = own_programs::of_option("--judge", path)?;
            keys.push(("--judge", "programs.gate", path.into()));
            // The controller takes its advice as that of any judge that answers at once.
            if arguments.gate.is_none() {
                keys.push(("--judge", "gate.mode", "rules".into()));
            }
        }
        None if arguments.gate.is_some() => {
            keys.push(("--gate", "programs.gate", "".into()));
            keys.push(("--gate", "link.judge", "".into()));
        }
        None => {}
    }
    if let Some(address) = &arguments.learner {
        keys.push(("--learner", "link.learner", address.clone().into()));
        keys.push(("--learner", "learner.enabled", true.into()));
    }
    Ok(keys)
}

/// The address of a judge on another machine; `None` for a program. A program whose name
/// reads as an address needs a '/'.
fn address_of(judge: &Path) -> Option<String> {
    let text = judge.to_str()?;
    (!text.contains('/') && is_address(text)).then(|| text.into())
}

/// The absolute path, because the processes of a run may have different working
/// folders.
fn policy_file(path: &Path) -> Result<String, Failure> {
    let failed = |why: String| Failure::Usage(format!("--policy {}: {why}", path.display()));
    let whole = path
        .canonicalize()
        .map_err(|error| failed(error.to_string()))?;
    file::regular(&whole).map_err(|error| failed(error.to_string()))?;
    let text = whole.to_str().map(String::from);
    text.ok_or_else(|| failed("its name is no UTF-8".into()))
}

/// The option, key and value of what the options of the recording set.
fn recording_of(arguments: &Up) -> Result<Vec<(&'static str, &'static str, Value)>, Failure> {
    if arguments.no_record {
        return Ok(vec![("--no-record", "record.keep", "nothing".into())]);
    }
    let Some(folder) = &arguments.record else {
        return Ok(Vec::new());
    };
    let mut keys = vec![("--record", "record.keep", "everything".into())];
    if let Some(folder) = folder {
        keys.push(("--record", "record.folder", record_folder(folder)?.into()));
    }
    Ok(keys)
}

/// The absolute path, for the same reason; the folder need not exist yet.
fn record_folder(path: &Path) -> Result<String, Failure> {
    let failed = |why: String| Failure::Usage(format!("--record {}: {why}", path.display()));
    let whole = std::path::absolute(path).map_err(|error| failed(error.to_string()))?;
    let text = whole.to_str().map(String::from);
    text.ok_or_else(|| failed("its name is no UTF-8".into()))
}

/// A TOML value; text that is not one, such as a bare word, is a string.
fn value_of(text: &str) -> Value {
    format!("value = {text}")
        .parse::<Table>()
        .ok()
        .filter(|table| table.len() == 1)
        .and_then(|mut table| table.remove("value"))
        .unwrap_or_else(|| text.into())
}

/// Refuses an unknown key or a wrong type, so that the error names the option. Ranges
/// may depend on other keys and are checked with all of them.
fn check_alone(change: &Override) -> Result<(), Failure> {
    let mut alone = Table::new();
    insert(&mut alone, &change.key, change.value.clone());
    match from_toml(&alone.to_string(), &change.origin) {
        Ok(_) | Err(ConfigError::OutOfRange { .. }) => Ok(()),
        Err(ConfigError::Syntax { message, .. }) => {
            let origin = change.origin.clone();
            Err(ConfigError::Syntax { origin, message }.into())
        }
        Err(error) => Err(error.into()),
    }
}

fn lookup<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    match key.split_once('.') {
        None => table.get(key),
        Some((section, rest)) => lookup(table.get(section)?.as_table()?, rest),
    }
}

fn insert(table: &mut Table, key: &str, value: Value) {
    match key.split_once('.') {
        None => {
            table.insert(key.into(), value);
        }
        Some((section, rest)) => {
            let entry = table
                .entry(section)
                .or_insert_with(|| Value::Table(Table::new()));
            match entry.as_table_mut() {
                Some(inner) => insert(inner, rest, value),
                // The key leads through a value that is not a section.
                None => *entry = value,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::up::arguments::DriverChoice;

    #[test]
    fn an_option_ends_the_program_of_the_file_in_its_place_alone() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("mine.toml");
        let text = "[gate]\nmode = \"rules\"\n[programs]\nplanner = \"/my/planner\"\n\
            gate = \"/my/judge\"\n";
        std::fs::write(&file, text).expect("a file");
        let programs = |arguments: Up| {
            let config = Some(file.clone());
            let resolved = resolve(&Up {
                config,
                ..arguments
            });
            let programs = resolved.expect("a configuration").programs;
            [programs.planner, programs.gate]
        };
        assert_eq!(programs(Up::default()), ["/my/planner", "/my/judge"]);
        let mpc = Up {
            driver: Some(DriverChoice::Mpc),
            ..Up::default()
        };
        assert_eq!(programs(mpc), ["", "/my/judge"]);
        for gate in [GateChoice::Rules, GateChoice::Expert] {
            let gated = Up {
                gate: Some(gate),
                ..Up::default()
            };
            assert_eq!(programs(gated), ["/my/planner", ""], "{gate:?}");
        }
        let judged = Up {
            gate: Some(GateChoice::Rules),
            judge: Some("/bin/sh".into()),
            ..Up::default()
        };
        assert_eq!(programs(judged), ["/my/planner", "/bin/sh"]);
    }

    #[test]
    fn an_address_is_a_judge_elsewhere_and_a_path_a_program() {
        let far = |judge: &str| {
            let resolved = resolve(&Up {
                judge: Some(judge.into()),
                learner: Some("0.0.0.0:7451".into()),
                ..Up::default()
            });
            resolved.expect("a configuration")
        };
        let config = far("0.0.0.0:7450");
        assert_eq!(config.link.judge, "0.0.0.0:7450");
        assert_eq!(config.link.learner, "0.0.0.0:7451");
        assert!(config.learner.enabled && config.programs.gate.is_empty());
        assert_eq!(config.gate.mode, GateMode::Rules);
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("mine.toml");
        std::fs::write(&file, "[gate]\nmode = \"vlm\"\n").expect("a file");
        let config = resolve(&Up {
            config: Some(file),
            judge: Some("0.0.0.0:7450".into()),
            ..Up::default()
        });
        assert_eq!(config.expect("a configuration").gate.mode, GateMode::Vlm);
        let config = far("/bin/sh");
        assert_eq!(
            (config.link.judge.as_str(), config.programs.gate.as_str()),
            ("", "/bin/sh")
        );
    }
}
