//! What all parts of one piece of work have in common: command, build, options and
//! configuration. Parts with other terms are of other work.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use shm_config::config::Config;
use toml::{Table, Value};

use super::Shard;
use crate::report::hex;
use crate::sections::{DECISIVE, WAITS};

/// Number of differences that an error names.
const NAMED: usize = 3;

/// Figures also depend on the model that is asked.
const MODEL: &str = "vlm";

/// The terms by name.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Terms(BTreeMap<String, String>);

impl Terms {
    /// Those of every command: its name, the number of parts, version and commit of the
    /// build.
    pub fn new(command: &str, shard: Shard) -> Terms {
        let mut terms = Terms::default();
        terms.add("command", command);
        terms.add("number of shards", shard.of);
        terms.add("version", env!("CARGO_PKG_VERSION"));
        // `./vlaps` sets it; an installed package has none.
        terms.add("commit", std::env::var("VLAPS_COMMIT").unwrap_or_default());
        terms
    }

    /// Adds a term.
    pub fn add(&mut self, name: &str, value: impl ToString) {
        self.0.insert(name.into(), value.to_string());
    }

    /// Adds the settings that figures may depend on.
    ///
    /// # Errors
    /// If the configuration has no text.
    pub fn add_config(&mut self, config: &Config) -> anyhow::Result<()> {
        let table = Table::try_from(config).context("the configuration")?;
        for section in DECISIVE.into_iter().chain([MODEL]) {
            if let Some(value) = table.get(section) {
                self.add_value(section, value);
            }
        }
        Ok(())
    }

    fn add_value(&mut self, name: &str, value: &Value) {
        match value {
            Value::Table(table) => {
                for (key, value) in table {
                    self.add_value(&format!("{name}.{key}"), value);
                }
            }
            // Where a machine keeps the key decides nothing, nor does how long it waits.
            _ if name.starts_with("vlm.key") || WAITS.contains(&name) => {}
            other => self.add(name, other),
        }
    }

    /// Adds a file by its content, which may have another path on another machine.
    ///
    /// # Errors
    /// If it cannot be read.
    pub fn add_content(&mut self, name: &str, file: &Path) -> anyhow::Result<()> {
        let named = || file.display().to_string();
        shm_config::file::regular(file).with_context(named)?;
        let bytes = std::fs::read(file).with_context(named)?;
        let digits = hex(&policy::sha256(&bytes)[..8]);
        self.add(name, format!("content {digits}"));
        Ok(())
    }

    /// A term.
    ///
    /// # Errors
    /// If there is none of that name.
    pub fn get(&self, name: &str) -> anyhow::Result<&str> {
        let found = self.0.get(name).map(String::as_str);
        found.with_context(|| format!("no {name:?} among the terms of the shards"))
    }

    /// A section of the configuration that figures may depend on.
    ///
    /// # Errors
    /// If a term of it is none of its settings.
    pub fn section<T: DeserializeOwned>(&self, name: &str) -> anyhow::Result<T> {
        let of_section = |(term, value): (&String, &String)| {
            let key = term.strip_prefix(name)?.strip_prefix('.')?;
            Some(format!("{key} = {value}\n"))
        };
        let text: String = self.0.iter().filter_map(of_section).collect();
        toml::from_str(&text).with_context(|| format!("[{name}] among the terms of the shards"))
    }

    /// Number of terms whose names begin so.
    pub fn count(&self, beginning: &str) -> usize {
        let names = self.0.keys();
        names.filter(|name| name.starts_with(beginning)).count()
    }

    /// A term that is a number.
    ///
    /// # Errors
    /// If there is none of that name, or it is no number.
    pub fn number<T: std::str::FromStr>(&self, name: &str) -> anyhow::Result<T> {
        let text = self.get(name)?;
        let number = text.parse().ok();
        number.with_context(|| format!("{name} = {text:?} among the terms of the shards"))
    }

    /// How these terms, which are there already, differ from those asked for, in words:
    /// `--episodes 100, not 50`; `None` if they are equal.
    pub fn difference(&self, asked: &Terms) -> Option<String> {
        let names = self.0.keys().chain(asked.0.keys());
        let names: std::collections::BTreeSet<_> = names.collect();
        let absent = "absent".to_string();
        let differing = names.into_iter().filter_map(|name| {
            let was = self.0.get(name).unwrap_or(&absent);
            let now = asked.0.get(name).unwrap_or(&absent);
            let word = |text: &str| match text.is_empty() {
                true => "none".to_string(),
                false => text.to_string(),
            };
            (was != now).then(|| format!("{name} {}, not {}", word(was), word(now)))
        });
        let differing: Vec<String> = differing.collect();
        let more = match differing.len().saturating_sub(NAMED) {
            0 => String::new(),
            more => format!("; and {more} more"),
        };
        let named = &differing[..differing.len().min(NAMED)];
        (!named.is_empty()).then(|| format!("{}{more}", named.join("; ")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_difference_names_the_option_and_both_values() {
        let shard = Shard { number: 1, of: 8 };
        let with = |episodes: u64, key: f64| {
            let mut terms = Terms::new("eval", shard);
            terms.add("--episodes", episodes);
            let mut config = Config::default();
            config.controller.lookahead_m = key;
            terms.add_config(&config).expect("a configuration");
            terms
        };
        let one = with(100, 5.0);
        assert_eq!(one.difference(&one.clone()), None);
        let words = one.difference(&with(50, 5.0)).expect("other episodes");
        assert_eq!(words, "--episodes 100, not 50");
        let words = one.difference(&with(100, 6.0)).expect("another setting");
        assert_eq!(words, "controller.lookahead_m 5.0, not 6.0");
        let waiting = |wait_s: f64, age_ms: f64| {
            let mut terms = Terms::default();
            let mut config = Config::default();
            config.limits.lockstep_wait_s = wait_s;
            config.limits.command_age_ms = age_ms;
            terms.add_config(&config).expect("a configuration");
            terms
        };
        let patient = waiting(1.0, 250.0);
        assert_eq!(patient.difference(&waiting(90.0, 250.0)), None);
        let words = patient.difference(&waiting(1.0, 300.0)).expect("a limit");
        assert_eq!(words, "limits.command_age_ms 250.0, not 300.0");
        let fewer = Terms::new("eval", Shard { number: 1, of: 4 });
        let words = fewer.difference(&Terms::new("eval", shard)).expect("N");
        assert_eq!(words, "number of shards 4, not 8");
        assert!(one.difference(&fewer).expect("much").contains("more"));
    }
}
