//! Errors for values that are not a number of the key's kind, such as -4 for a count;
//! they name the valid range.

use toml::{Table, Value};

use super::{Config, OutOfRange};
use crate::shortened;

/// The first key whose value is not a number of its kind; `None` when the error is
/// another one.
pub(super) fn wrong_number(given: &Table, known: &Table) -> Option<OutOfRange> {
    first_wrong(given, known, &mut Vec::new())
}

fn first_wrong(given: &Table, known: &Table, path: &mut Vec<String>) -> Option<OutOfRange> {
    for (key, value) in given {
        path.push(key.clone());
        let found = match (value, known.get(key)) {
            (Value::Table(given), Some(Value::Table(known))) => first_wrong(given, known, path),
            (value, Some(Value::Integer(_) | Value::Float(_))) => wrong(path, value),
            _ => None,
        };
        if found.is_some() {
            return found;
        }
        path.pop();
    }
    None
}

fn wrong(path: &[String], value: &Value) -> Option<OutOfRange> {
    let error = config_with(path, value.clone()).err()?;
    // The library names the kind of whole number, such as u32.
    let kind = error.message().rsplit("expected ").next()?.trim();
    let is_whole = ["u8", "u16", "u32", "u64", "usize", "i32", "i64"].contains(&kind);
    let is_number = is_whole || ["f32", "f64"].contains(&kind);
    is_number.then(|| OutOfRange {
        key: path.join("."),
        value: shortened(&value.to_string()),
        expected: expected(path, is_whole),
    })
}

/// The valid range: the text with which the key refuses the least and the greatest
/// number.
fn expected(path: &[String], is_whole: bool) -> String {
    let extremes = match is_whole {
        true => [i64::MAX, i64::from(u32::MAX), i64::from(i32::MIN), 0].map(Value::Integer),
        false => [f64::MAX, f64::MIN, f64::NAN, 0.0].map(Value::Float),
    };
    let key = path.join(".");
    let refused = extremes.into_iter().find_map(|extreme| {
        let error = config_with(path, extreme).ok()?.validated().err()?;
        (error.key == key).then_some(error.expected)
    });
    refused.unwrap_or_else(|| match is_whole {
        true => "a whole number from 0".into(),
        false => "a number".into(),
    })
}

/// The defaults with one key changed.
fn config_with(path: &[String], value: Value) -> Result<Config, toml::de::Error> {
    let mut changed = value;
    for key in path.iter().rev() {
        let mut section = Table::new();
        section.insert(key.clone(), changed);
        changed = Value::Table(section);
    }
    changed.try_into()
}

#[cfg(test)]
mod tests {
    use super::super::from_toml;

    #[test]
    fn a_number_of_the_wrong_kind_is_told_with_the_keys_range() {
        let told = |text: &str| from_toml(text, "a.toml").expect_err(text).to_string();
        assert_eq!(
            told("[planner]\niterations = -4\n"),
            "a.toml:2: planner.iterations = -4: must be a whole number from 1 to 4095"
        );
        assert_eq!(
            told("[gate]\nperiod_s = \"often\"\n"),
            "a.toml:2: gate.period_s = \"often\": must be within 0.001 and 3600"
        );
        assert_eq!(
            told("[run]\nseed = -1\n"),
            "a.toml:2: run.seed = -1: must be a whole number from 0"
        );
        // A list is not a number; the library's own error stays.
        assert!(told("[run]\nclock = 3\n").contains("a.toml:2"));
    }
}
