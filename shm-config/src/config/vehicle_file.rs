//! Vehicle files: the part of a configuration that belongs to a car.

use std::path::Path;

use toml::{Table, Value};

use super::{ConfigError, from_toml, text_of};

/// The sections of a vehicle file.
const SECTIONS: [&str; 2] = ["vehicle", "scanner"];
/// The one key of another section: the rate at which the car is driven.
const RATE: (&str, &str) = ("run", "rate_hz");

/// Reads and checks a vehicle file: the sections `[vehicle]` and `[scanner]`, and
/// `run.rate_hz`. The table has the keys that the file gives.
///
/// # Errors
/// One line that says what is wrong, where, and what to do: the file cannot be read, is
/// no TOML, has an unknown key or a value out of its range, says nothing about the car,
/// or holds settings of a run.
pub fn vehicle_of(path: &Path) -> Result<Table, ConfigError> {
    let text = text_of(path)?;
    let origin = path.display().to_string();
    from_toml(&text, &origin)?;
    let wrong = |message: String| ConfigError::Syntax {
        origin: origin.clone(),
        message,
    };
    let table: Table = text.parse().map_err(|error| wrong(format!("{error}")))?;
    for (section, value) in &table {
        if SECTIONS.contains(&section.as_str()) {
            continue;
        }
        let keys = value.as_table().into_iter().flat_map(Table::keys);
        if let Some(key) = keys
            .into_iter()
            .find(|key| (section.as_str(), key.as_str()) != RATE)
        {
            return Err(wrong(format!(
                "{section}.{key} is no key of a vehicle: a vehicle file has the sections \
                 [vehicle] and [scanner], and run.rate_hz; put it into vlaps.toml"
            )));
        }
    }
    match SECTIONS.iter().any(|section| table.contains_key(*section)) {
        true => Ok(table),
        false => Err(wrong(
            "has neither a section [vehicle] nor [scanner]: it is no vehicle file".into(),
        )),
    }
}

/// Puts the keys of a vehicle file into a configuration's table, in place of its own.
pub fn with_vehicle(mut table: Table, vehicle: Table) -> Table {
    for (section, value) in vehicle {
        match (table.get_mut(&section), value) {
            (Some(Value::Table(own)), Value::Table(keys)) => own.extend(keys),
            (_, value) => {
                table.insert(section, value);
            }
        }
    }
    table
}
