//! `config`: every key with its default and its meaning, or the check of a file.

use clap::Args;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;

use shm_config::config::{self, Config, ConfigError};

use crate::cli::failure::Failure;
use crate::cli::print::say;

/// Print the configuration with its defaults, or check a file.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
        ./vlaps config > vlaps.toml       a file to edit\n  \
        ./vlaps config --check vlaps.toml\n  \
        ./vlaps config --vehicle vehicles/truck.toml")]
pub struct ConfigArguments {
    /// Check this file instead; exit code 2 when it is wrong.
    #[arg(long, value_name = "FILE")]
    pub check: Option<PathBuf>,
    /// Print the configuration of the car of this vehicle file in place of the defaults:
    /// speeds, distances and gains follow the car where no file gives them.
    #[arg(long, value_name = "FILE", conflicts_with = "check")]
    pub vehicle: Option<PathBuf>,
}

/// The source files of the configuration. The doc comment of each key, written there
/// once, is read from them.
const SOURCES: &[&str] = &[
    include_str!("../../../shm-config/src/config/mod.rs"),
    include_str!("../../../shm-config/src/config/run.rs"),
    include_str!("../../../shm-config/src/config/record.rs"),
    include_str!("../../../shm-config/src/config/deadlines.rs"),
    include_str!("../../../shm-config/src/config/world.rs"),
    include_str!("../../../shm-config/src/config/programs.rs"),
    include_str!("../../../shm-config/src/config/link.rs"),
    include_str!("../../../shm-config/src/settings/planner.rs"),
    include_str!("../../../shm-config/src/settings/informed.rs"),
    include_str!("../../../shm-config/src/settings/kinodynamic.rs"),
    include_str!("../../../shm-config/src/config/mpc.rs"),
    include_str!("../../../shm-config/src/settings/controller.rs"),
    include_str!("../../../shm-config/src/config/gate.rs"),
    include_str!("../../../shm-config/src/config/vlm.rs"),
    include_str!("../../../shm-config/src/config/policy.rs"),
    include_str!("../../../shm-config/src/config/learner.rs"),
    include_str!("../../../vehicle/src/parameters.rs"),
    include_str!("../../../vehicle/src/scanner.rs"),
];

/// A field's doc comment and type, by struct and field.
type Docs = BTreeMap<(String, String), (String, String)>;

/// Prints the defaults, or checks a file.
///
/// # Errors
/// When the file is wrong.
pub fn config(arguments: &ConfigArguments) -> Result<(), Failure> {
    match &arguments.check {
        Some(path) => {
            config::load(path)?;
            say(format_args!("{}: a valid configuration", path.display()));
        }
        None => {
            let config = match &arguments.vehicle {
                Some(path) => {
                    let table = config::vehicle_of(path)?;
                    config::from_toml(&table.to_string(), &path.display().to_string())?
                }
                None => Config::default(),
            };
            say(documented(&config)?.trim_end());
        }
    }
    Ok(())
}

/// The default configuration as TOML, each key below its description.
///
/// # Errors
/// When the defaults cannot be written as TOML.
pub fn documented_defaults() -> Result<String, Failure> {
    documented(&Config::default())
}

fn documented(config: &Config) -> Result<String, Failure> {
    let defaults = toml::to_string(config).map_err(|error| ConfigError::Syntax {
        origin: "built-in defaults".into(),
        message: error.to_string(),
    })?;
    let docs = docs();
    let mut text =
        String::from("# Every key with its default. A file need name only what it changes.\n\n");
    let mut section_type = String::new();
    // Each section and each key has a line of its own.
    for line in defaults.lines() {
        let key = line.split(" = ").next().unwrap_or(line);
        let about = match line.strip_prefix('[') {
            Some(section) => {
                let section = section.trim_end_matches(']');
                let (about, type_name) = doc_of(&docs, "Config", section);
                section_type = type_name;
                about
            }
            None => doc_of(&docs, &section_type, key).0,
        };
        text.push_str(&about);
        text.push_str(line);
        text.push('\n');
    }
    Ok(text)
}

/// The comment lines and the type of one field; nothing when it has no comment.
fn doc_of(docs: &Docs, type_name: &str, field: &str) -> (String, String) {
    docs.get(&(type_name.into(), field.into()))
        .cloned()
        .unwrap_or_default()
}

/// The doc comments of all fields. The sources are formatted by rustfmt, so each field
/// has a line of its own.
fn docs() -> Docs {
    let mut docs = Docs::new();
    for source in SOURCES {
        let mut inside = None;
        let mut comment = String::new();
        for line in source.lines().map(str::trim) {
            if let Some(text) = line.strip_prefix("///") {
                let _ = writeln!(comment, "#{text}");
                continue;
            }
            let mut words = line.split_whitespace();
            match (words.next(), words.next(), words.next()) {
                (Some("pub"), Some("struct"), Some(name)) => inside = Some(name.to_string()),
                (Some("}"), None, None) => inside = None,
                (Some("pub"), Some(field), Some(type_name)) => {
                    if let (Some(name), Some(field)) = (&inside, field.strip_suffix(':')) {
                        docs.insert(
                            (name.clone(), field.into()),
                            (comment.clone(), type_name.trim_end_matches(',').into()),
                        );
                    }
                }
                _ => {}
            }
            comment.clear();
        }
    }
    docs
}
