#[cfg(feature = "wire")]
use std::path::Path;
use std::path::PathBuf;

use super::wrong_type::wrong_number;
use super::{Config, OutOfRange};
#[cfg(feature = "wire")]
use crate::file;
use crate::shortened;
use crate::text::printable;

#[cfg(feature = "wire")]
/// Largest configuration file, bytes: a hundred times the printed defaults.
const BYTES_MAX: u64 = 1 << 20;

/// Most characters of a part of an error that are shown: several times the longest
/// valid one.
const SHOWN_MAX: usize = 1000;

/// Longest key for which a similar one is suggested, bytes: the search takes time that
/// grows with the square of the length, and no key has 40.
const MISTAKEN_MAX: usize = 100;

/// Why a configuration could not be used: what, where, and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: cannot read the configuration: {source}", shown(&.path.display()))]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A key that does not exist.
    #[error("{}: unknown key '{}'{}", shown(.origin), shown(&shortened(.key)), suggestion(.nearest))]
    UnknownKey {
        /// The file.
        origin: String,
        /// The key with its section.
        key: String,
        /// The valid key most similar to it.
        nearest: Option<String>,
    },
    /// The text is not TOML, or a value has the wrong type.
    #[error("{}: {}", shown(.origin), shown(.message))]
    Syntax {
        /// The file, with the line if known.
        origin: String,
        /// The fault.
        message: String,
    },
    /// A value out of its range.
    #[error("{}: {}", shown(.origin), shown(.error))]
    OutOfRange {
        /// The file.
        origin: String,
        /// The key, its value, and the valid values.
        error: OutOfRange,
    },
}

/// A part of an error made fit to be shown: text from a file may hold any character and
/// be as long as the file.
fn shown(part: &dyn std::fmt::Display) -> String {
    let text = part.to_string();
    let mut chars = text.chars();
    let mut start: String = chars.by_ref().take(SHOWN_MAX).collect();
    if chars.next().is_some() {
        start.push('…');
    }
    printable(&start).into_owned()
}

fn suggestion(nearest: &Option<String>) -> String {
    match nearest {
        Some(key) => format!("; did you mean '{key}'?"),
        None => "; ./vlaps config prints every key with its default".into(),
    }
}

#[cfg(feature = "wire")]
/// Reads, checks and completes a configuration file.
///
/// # Errors
/// One line that says what is wrong, where, and what to do.
pub fn load(path: &Path) -> Result<Config, ConfigError> {
    from_toml(&text_of(path)?, &path.display().to_string())
}

#[cfg(feature = "wire")]
/// The text of a configuration file.
///
/// # Errors
/// When it is not a file, is too large, or cannot be read.
pub fn text_of(path: &Path) -> Result<String, ConfigError> {
    let read = |source| ConfigError::Read {
        path: path.into(),
        source,
    };
    file::read_text(path, BYTES_MAX).map_err(|error| match error.kind() {
        std::io::ErrorKind::FileTooLarge => read(std::io::Error::new(
            std::io::ErrorKind::InvalidInput,
            "is larger than any configuration",
        )),
        _ => read(error),
    })
}

/// Checks and completes a configuration, presets of `gate.mode` included; `origin` names
/// it in errors.
///
/// # Errors
/// One line that says what is wrong, where, and what to do.
pub fn from_toml(text: &str, origin: &str) -> Result<Config, ConfigError> {
    let syntax = |error: toml::de::Error| {
        let line = error
            .span()
            .map(|span| text[..span.start.min(text.len())].lines().count().max(1));
        ConfigError::Syntax {
            origin: match line {
                Some(line) => format!("{origin}:{line}"),
                None => origin.into(),
            },
            message: error.message().trim().replace('\n', "; "),
        }
    };
    let given: toml::Table = text.parse().map_err(syntax)?;
    let known = toml::Table::try_from(Config::default()).map_err(|error| ConfigError::Syntax {
        origin: "built-in defaults".into(),
        message: error.to_string(),
    })?;
    if let Some(key) = unknown_key(&given, &known, "") {
        let mut keys = Vec::new();
        all_keys(&known, "", &mut keys);
        return Err(ConfigError::UnknownKey {
            origin: origin.into(),
            nearest: match key.len() <= MISTAKEN_MAX {
                true => nearest(&key, &keys),
                false => None,
            },
            key,
        });
    }
    let config: Config = toml::from_str(text).map_err(|error| {
        let plain = syntax(error);
        match (plain, wrong_number(&given, &known)) {
            (ConfigError::Syntax { origin, .. }, Some(error)) => {
                let message = error.to_string();
                ConfigError::Syntax { origin, message }
            }
            (plain, _) => plain,
        }
    })?;
    let fitted = config
        .checked_vehicle()
        .map(|config| config.fitted_to_vehicle(&given));
    let checked = fitted.and_then(Config::validated).map(Config::with_preset);
    checked.map_err(|error| ConfigError::OutOfRange {
        origin: origin.into(),
        error,
    })
}

fn path_of(section: &str, key: &str) -> String {
    if section.is_empty() {
        key.into()
    } else {
        format!("{section}.{key}")
    }
}

fn unknown_key(given: &toml::Table, known: &toml::Table, section: &str) -> Option<String> {
    given.iter().find_map(|(key, value)| {
        let path = path_of(section, key);
        match (value, known.get(key)) {
            (_, None) => Some(path),
            (toml::Value::Table(given), Some(toml::Value::Table(known))) => {
                unknown_key(given, known, &path)
            }
            _ => None,
        }
    })
}

fn all_keys(known: &toml::Table, section: &str, out: &mut Vec<String>) {
    for (key, value) in known {
        let path = path_of(section, key);
        if let toml::Value::Table(table) = value {
            all_keys(table, &path, out);
        }
        out.push(path);
    }
}

/// The key most similar to the wrong one, by its whole path or its last part.
fn nearest(key: &str, keys: &[String]) -> Option<String> {
    let last = |path: &str| path.rsplit('.').next().unwrap_or(path).to_string();
    let likeness = |candidate: &String| {
        strsim::jaro_winkler(key, candidate)
            .max(strsim::jaro_winkler(&last(key), &last(candidate)) - 0.05)
    };
    keys.iter()
        .map(|candidate| (likeness(candidate), candidate))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(likeness, _)| *likeness > 0.75)
        .map(|(_, candidate)| candidate.clone())
}
