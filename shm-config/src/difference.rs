//! Where two messages of one type differ, by the name of the field.

use crate::layout::{Field, Layout, Table};

/// The first field that differs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// Its path, such as `observation.ego.speed_mps` or `plan.waypoints[3].x_body_m`.
    pub field: String,
    /// Its value in the first message.
    pub left: String,
    /// Its value in the second.
    pub right: String,
}

/// The first field in which two messages differ by a bit, in order of memory;
/// `None` when all bytes are equal.
pub fn first_difference<M: Layout>(left: &M, right: &M) -> Option<Difference> {
    let (left, right) = (left.as_bytes(), right.as_bytes());
    (left != right)
        .then(|| within(M::TABLE, String::new(), left, right))
        .flatten()
}

/// The first difference inside one message, whose fields are named behind `path`.
fn within(table: &Table, path: String, left: &[u8], right: &[u8]) -> Option<Difference> {
    let field = table.fields.iter().find(|field| {
        let range = field.offset..field.offset + field.size;
        left[range.clone()] != right[range]
    })?;
    let path = match path.is_empty() {
        true => field.name.to_string(),
        false => format!("{path}.{}", field.name),
    };
    let range = field.offset..field.offset + field.size;
    in_field(table, field, path, &left[range.clone()], &right[range])
}

/// The first difference inside one field: of its elements the first that differs.
fn in_field(
    table: &Table,
    field: &Field,
    path: String,
    left: &[u8],
    right: &[u8],
) -> Option<Difference> {
    let element = field.type_name.strip_prefix('[');
    let element = element.and_then(|name| name.split_once(';'));
    let type_name = element.map_or(field.type_name, |(name, _)| name.trim());
    let nested = table.nested.iter().find(|nested| nested.name == type_name);
    let size = match (nested, type_name) {
        (Some(nested), _) => nested
            .fields
            .last()
            .map_or(0, |last| last.offset + last.size),
        (None, "u8") => 1,
        (None, "u32" | "f32") => 4,
        (None, "u64" | "f64") => 8,
        (None, _) => field.size,
    };
    let size = size.max(1);
    let mut pairs = left.chunks(size).zip(right.chunks(size));
    let index = pairs.position(|(left, right)| left != right)?;
    let [left, right] = [left, right].map(|bytes| &bytes[index * size..][..size]);
    let path = match element {
        Some(_) => format!("{path}[{index}]"),
        None => path,
    };
    match nested {
        Some(nested) => within(nested, path, left, right),
        None => Some(Difference {
            field: path,
            left: value(type_name, left),
            right: value(type_name, right),
        }),
    }
}

/// A number as users read it; other bytes in hexadecimal.
fn value(type_name: &str, bytes: &[u8]) -> String {
    let number = match type_name {
        "u8" => bytes
            .try_into()
            .ok()
            .map(|b| u8::from_ne_bytes(b).to_string()),
        "u32" => bytes
            .try_into()
            .ok()
            .map(|b| u32::from_ne_bytes(b).to_string()),
        "u64" => bytes
            .try_into()
            .ok()
            .map(|b| u64::from_ne_bytes(b).to_string()),
        "f32" => bytes
            .try_into()
            .ok()
            .map(|b| f32::from_ne_bytes(b).to_string()),
        "f64" => bytes
            .try_into()
            .ok()
            .map(|b| f64::from_ne_bytes(b).to_string()),
        _ => None,
    };
    number.unwrap_or_else(|| format!("{bytes:02x?}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Step;

    #[test]
    fn a_field_is_named_with_its_path_and_both_values() {
        let left = Step::default();
        assert_eq!(first_difference(&left, &left), None);
        let mut right = left;
        right.before.pd.speed_mps = -0.5;
        right.plan.waypoints[3].x_body_m = 1.0;
        let found = |right: &Step| {
            let found = first_difference(&left, right).expect("a difference");
            (found.field, found.left, found.right)
        };
        let expected = |field: &str, left: &str, right: &str| {
            (field.to_string(), left.to_string(), right.to_string())
        };
        let name = "before.pd.speed_mps";
        assert_eq!(found(&right), expected(name, "0", "-0.5"));
        right.before.pd.speed_mps = 0.0;
        let name = "plan.waypoints[3].x_body_m";
        assert_eq!(found(&right), expected(name, "0", "1"));
        right.plan.waypoints[3].x_body_m = -0.0;
        assert_eq!(found(&right), expected(name, "0", "-0"));
        right.plan.waypoints[3].x_body_m = 0.0;
        right.observation.ranges_m[239] = 2.5;
        assert_eq!(
            found(&right),
            expected("observation.ranges_m[239]", "0", "2.5")
        );
        right.observation.ranges_m[239] = 0.0;
        right.lateness = 3;
        assert_eq!(found(&right), expected("lateness", "0", "3"));
    }
}
