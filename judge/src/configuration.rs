//! The configuration of a command: a file and overrides.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use shm_config::config::{Config, from_toml};
use toml::{Table, Value};

/// Read from the current folder if it exists and no other file is given.
const DEFAULT_FILE: &str = "vlaps.toml";

/// The configuration of the run with overrides.
///
/// # Errors
/// When the file cannot be read, or a key or a value is invalid.
pub fn config(file: Option<&Path>, overrides: &[String]) -> anyhow::Result<Config> {
    let default = PathBuf::from(DEFAULT_FILE);
    let file = file
        .map(Path::to_path_buf)
        .or_else(|| default.is_file().then_some(default));
    let (mut table, origin) = match file {
        Some(path) => {
            let text = std::fs::read_to_string(&path)
                .with_context(|| format!("cannot read {}", path.display()))?;
            from_toml(&text, &path.display().to_string())?;
            (text.parse::<Table>()?, path.display().to_string())
        }
        None => (Table::new(), "the command line".into()),
    };
    for text in overrides {
        let (key, value) = text
            .split_once('=')
            .with_context(|| format!("--set {text}: must be KEY=VALUE"))?;
        let (section, key) = key
            .split_once('.')
            .with_context(|| format!("--set {text}: KEY must have a section, such as vlm.model"))?;
        let section = table
            .entry(section)
            .or_insert_with(|| Value::Table(Table::new()));
        let section = section.as_table_mut().context("a section is not a value")?;
        section.insert(key.into(), parsed(value));
    }
    Ok(from_toml(&table.to_string(), &origin)?)
}

/// Parses a TOML value; other text is a string, so that names need no quotes.
fn parsed(text: &str) -> Value {
    let line: Result<Table, _> = format!("value = {text}").parse();
    line.ok()
        .and_then(|mut table| table.remove("value"))
        .unwrap_or_else(|| text.into())
}
