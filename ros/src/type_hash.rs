//! RIHS01: the hash of a message type, by which ROS 2 tells versions of a type apart.
//!
//! It is the SHA-256 of a JSON text of the type's description and those of all types nested
//! in it (REP 2016): names and types of the fields, without comments, constants and defaults.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use sha2::{Digest as _, Sha256};

/// The first line of a nested type's definition begins so.
const NESTED: &str = "MSG: ";
/// Added to the code of an element's type for an array of a fixed length.
const ARRAY: u32 = 48;
/// And for a sequence of any length.
const SEQUENCE: u32 = 144;

/// Codes of the primitive types in `type_description_interfaces/msg/FieldType`.
const PRIMITIVES: &[(&str, u32)] = &[
    ("int8", 2),
    ("uint8", 3),
    ("int16", 4),
    ("uint16", 5),
    ("int32", 6),
    ("uint32", 7),
    ("int64", 8),
    ("uint64", 9),
    ("float32", 10),
    ("float64", 11),
    ("bool", 15),
    ("byte", 16),
    ("string", 17),
];
/// The code of a nested type.
const OTHER: u32 = 1;

/// `RIHS01_` and the hash in hexadecimal, of a type such as `nav_msgs/msg/Path` with its
/// definition in the format `ros2msg`.
///
/// # Errors
/// The line that is not understood: bounded sequences, constants and defaults are not.
pub fn rihs01(name: &str, definition: &str) -> Result<String, String> {
    let mut types = BTreeMap::new();
    let mut at = name.to_string();
    for line in definition.lines() {
        if let Some(nested) = line.strip_prefix(NESTED) {
            at = full_name(nested);
            continue;
        }
        if line.is_empty() || line.starts_with('=') {
            continue;
        }
        let fields: &mut Vec<String> = types.entry(at.clone()).or_default();
        fields.push(field(line).ok_or_else(|| format!("{name}: `{line}` is not understood"))?);
    }
    let own = types.remove(name);
    let own = description(name, &own.ok_or_else(|| format!("{name}: has no field"))?);
    let nested: Vec<_> = types
        .iter()
        .map(|(name, fields)| description(name, fields))
        .collect();
    let nested = nested.join(", ");
    let json =
        format!(r#"{{"type_description": {own}, "referenced_type_descriptions": [{nested}]}}"#);
    let mut hash = String::from("RIHS01_");
    for byte in Sha256::digest(json.as_bytes()) {
        // Writing to a String cannot fail.
        let _ = write!(hash, "{byte:02x}");
    }
    Ok(hash)
}

/// `geometry_msgs/Point` as `geometry_msgs/msg/Point`.
fn full_name(short: &str) -> String {
    short.replacen('/', "/msg/", 1)
}

fn description(name: &str, fields: &[String]) -> String {
    let fields = fields.join(", ");
    format!(r#"{{"type_name": "{name}", "fields": [{fields}]}}"#)
}

/// One field as JSON.
fn field(line: &str) -> Option<String> {
    let (type_name, name) = line.split_once(' ')?;
    let is_plain = |word: &str| {
        let mut bytes = word.bytes();
        bytes.all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'/')
    };
    let (element, array) = match type_name.split_once('[') {
        Some((element, length)) => (element, Some(length.strip_suffix(']')?)),
        None => (type_name, None),
    };
    if !is_plain(element) || !is_plain(name) || name.contains('/') {
        return None;
    }
    let primitive = PRIMITIVES.iter().find(|(word, _)| *word == element);
    let (code, nested) = match primitive {
        Some((_, code)) => (*code, String::new()),
        None if element.contains('/') => (OTHER, full_name(element)),
        None => return None,
    };
    let (code, capacity) = match array {
        None => (code, 0),
        Some("") => (code + SEQUENCE, 0),
        Some(length) => (code + ARRAY, length.parse::<u64>().ok()?),
    };
    Some(format!(
        r#"{{"name": "{name}", "type": {{"type_id": {code}, "capacity": {capacity}, "string_capacity": 0, "nested_type_name": "{nested}"}}}}"#
    ))
}

#[cfg(test)]
mod tests {
    use recorder::standard::definition;

    use super::*;

    /// Hashes that ROS 2 Jazzy's own packages carry.
    #[test]
    fn the_hash_is_that_of_ros() {
        let string = rihs01("std_msgs/msg/String", "string data\n");
        assert_eq!(
            string.as_deref(),
            Ok("RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18")
        );
        let scan = rihs01(
            "sensor_msgs/msg/LaserScan",
            &definition("sensor_msgs/LaserScan"),
        );
        assert_eq!(
            scan.as_deref(),
            Ok("RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828")
        );
    }

    #[test]
    fn what_is_not_understood_is_named() {
        for text in [
            "",
            "float64\n",
            "float64[<=3] x\n",
            "float65 x\n",
            "float64 x 1.0\n",
            "uint8 A=1\n",
            "float64[x] x\n",
            "string \"x\n",
        ] {
            let error = rihs01("a/msg/B", text).expect_err(text);
            assert!(error.starts_with("a/msg/B: "), "{error}");
            assert_eq!(error.lines().count(), 1, "{error}");
        }
    }
}
