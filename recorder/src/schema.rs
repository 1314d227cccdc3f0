//! Message layouts as ROS 2 message definitions.
//!
//! A message is `repr(C)` without padding and little-endian, with fields aligned to at
//! most eight bytes: behind the four bytes [`ENCAPSULATION`] that is XCDR1, the encoding of
//! ROS 2, byte for byte.

use std::fmt::Write;

use shm_config::layout::{Field, Table};

/// The package of the messages in ROS 2 names.
pub const PACKAGE: &str = "vlaps_msgs";
/// The first bytes of a message in CDR: little-endian, no options.
pub const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// Between two definitions in one schema.
pub(crate) const SEPARATOR: &str =
    "================================================================================";

/// The name of a message's schema, such as `vlaps_msgs/msg/Step`.
pub fn name(table: &Table) -> String {
    format!("{PACKAGE}/msg/{}", table.name)
}

/// The definition of a message in the format `ros2msg`, with all that are nested in it.
pub fn definition(table: &Table) -> String {
    let mut text = String::new();
    fields(&mut text, table);
    let mut nested = Vec::new();
    collect(table, &mut nested);
    for table in nested {
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{SEPARATOR}\nMSG: {PACKAGE}/{}", table.name);
        fields(&mut text, table);
    }
    text
}

/// The tables below this one, each once.
fn collect(table: &Table, into: &mut Vec<&'static Table>) {
    for nested in table.nested {
        if !into.iter().any(|known| known.name == nested.name) {
            into.push(nested);
            collect(nested, into);
        }
    }
}

fn fields(text: &mut String, table: &Table) {
    for field in table.fields {
        let _ = writeln!(text, "{} {}", type_of(table, field), field.name);
    }
}

/// The element's type and bytes, and `[count]` for an array.
fn type_of(table: &Table, field: &Field) -> String {
    let array = field.type_name.strip_prefix('[');
    let element = array.and_then(|name| name.split_once(';'));
    let element = element.map_or(field.type_name, |(name, _)| name.trim());
    let (word, bytes) = match element {
        "u8" => ("uint8".into(), 1),
        "u32" => ("uint32".into(), 4),
        "u64" => ("uint64".into(), 8),
        "f32" => ("float32".into(), 4),
        "f64" => ("float64".into(), 8),
        message => {
            let nested = table.nested.iter().find(|nested| nested.name == message);
            let end = nested.and_then(|nested| nested.fields.last());
            let bytes = end.map_or(1, |last| last.offset + last.size);
            (format!("{PACKAGE}/{message}"), bytes)
        }
    };
    match array {
        Some(_) => format!("{word}[{}]", field.size / bytes),
        None => word,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shm_config::layout::Layout;
    use shm_config::message::{Plan, Roster, Step};
    use shm_config::services::SERVICES;

    #[test]
    fn a_definition_has_each_field_with_its_type() {
        let text = definition(Plan::TABLE);
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines[0], "vlaps_msgs/Header header");
        assert!(
            lines.contains(&"vlaps_msgs/Waypoint[64] waypoints"),
            "{text}"
        );
        assert!(lines.contains(&"MSG: vlaps_msgs/Waypoint"), "{text}");
        assert!(lines.contains(&"float64 speed_mps"), "{text}");
        assert_eq!(name(Plan::TABLE), "vlaps_msgs/msg/Plan");
        assert!(definition(Roster::TABLE).contains("uint32["));
        // Nested several times, defined once.
        let text = definition(Step::TABLE);
        assert_eq!(text.matches("MSG: vlaps_msgs/Header\n").count(), 1);
    }

    /// Otherwise the struct would not be its own encoding.
    #[test]
    fn every_message_is_aligned_as_cdr_aligns_it() {
        fn check(table: &Table) {
            for field in table.fields {
                let element = field.type_name.trim_start_matches('[');
                let alignment = match element.split(';').next().unwrap_or("").trim() {
                    "u8" => 1,
                    "u32" | "f32" => 4,
                    "u64" | "f64" => 8,
                    message => {
                        let known = table.nested.iter().any(|nested| nested.name == message);
                        assert!(known, "{}.{} is unknown", table.name, field.name);
                        1
                    }
                };
                let (table, field_name) = (table.name, field.name);
                assert_eq!(field.offset % alignment, 0, "{table}.{field_name}");
            }
            table.nested.iter().for_each(|nested| check(nested));
        }
        for row in SERVICES {
            check(row.message.table);
            assert_eq!(row.message.bytes % 4, 0, "{}", row.name);
        }
    }
}
