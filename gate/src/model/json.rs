//! A JSON reader that is stricter than most: a key that occurs twice is an error,
//! because readers differ on which one counts, and the depth is limited.

use std::cell::Cell;
use std::fmt;

use serde::de::{DeserializeSeed, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Number, Value};

use super::Fault;

/// Reads the JSON value at the beginning of `text`, and returns the byte at which it
/// ends.
///
/// # Errors
/// `Truncated`, `NotJson`, `DuplicateKeys` or `TooDeep`.
pub fn read_first(text: &str, depth_max: u32) -> Result<(Value, usize), Fault> {
    let flaw = Cell::new(None);
    let mut reader = serde_json::Deserializer::from_str(text);
    let node = Node {
        depth_left: depth_max,
        flaw: &flaw,
    };
    match node.deserialize(&mut reader) {
        Ok(value) => Ok((value, reader.into_iter::<Value>().byte_offset())),
        Err(error) => Err(match flaw.get() {
            Some(flaw) => flaw,
            None if error.is_eof() => Fault::Truncated,
            None => Fault::NotJson,
        }),
    }
}

/// Reads a JSON value that is the whole of `text`.
///
/// # Errors
/// As [`read_first`]; `NotJson` when anything follows the value.
pub fn read(text: &str, depth_max: u32) -> Result<Value, Fault> {
    let (value, end) = read_first(text, depth_max)?;
    match text[end..].trim().is_empty() {
        true => Ok(value),
        false => Err(Fault::NotJson),
    }
}

/// One value and all below it. `serde_json` would accept the last of two equal keys,
/// and its own depth limit is larger.
struct Node<'a> {
    depth_left: u32,
    flaw: &'a Cell<Option<Fault>>,
}

impl Node<'_> {
    fn below<E: serde::de::Error>(&self) -> Result<Self, E> {
        let depth_left = self.depth_left.checked_sub(1);
        let depth_left = depth_left.ok_or_else(|| self.stop(Fault::TooDeep))?;
        Ok(Self {
            depth_left,
            flaw: self.flaw,
        })
    }

    fn stop<E: serde::de::Error>(&self, flaw: Fault) -> E {
        self.flaw.set(Some(flaw));
        E::custom(flaw.word())
    }
}

impl<'de> DeserializeSeed<'de> for Node<'_> {
    type Value = Value;

    fn deserialize<D: serde::Deserializer<'de>>(self, reader: D) -> Result<Value, D::Error> {
        reader.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Node<'_> {
    type Value = Value;

    fn expecting(&self, formatter: &mut fmt::Formatter) -> fmt::Result {
        formatter.write_str("a JSON value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(Value::Bool(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E: serde::de::Error>(self, value: f64) -> Result<Value, E> {
        Number::from_f64(value)
            .map(Value::Number)
            .ok_or_else(|| E::custom("not a number"))
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let mut values = Vec::new();
        while let Some(value) = list.next_element_seed(self.below()?)? {
            values.push(value);
        }
        Ok(Value::Array(values))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<Value, A::Error> {
        let mut object = Map::new();
        while let Some(key) = fields.next_key::<String>()? {
            if object.contains_key(&key) {
                return Err(self.stop(Fault::DuplicateKeys));
            }
            let value = fields.next_value_seed(self.below()?)?;
            object.insert(key, value);
        }
        Ok(Value::Object(object))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_read_as_serde_json_reads_them() {
        for text in [
            "null",
            "true",
            "-3",
            "18446744073709551615",
            "1.5",
            "\"a\\u00e4\"",
            "[1, [2, {}], []]",
            "{\"a\": {\"b\": [null]}, \"c\": 1e3}",
        ] {
            let expected: Value = serde_json::from_str(text).expect(text);
            assert_eq!(read(text, 8), Ok(expected), "{text}");
        }
    }

    #[test]
    fn each_error_has_its_fault() {
        for (text, fault) in [
            ("{\"a\": 1, \"a\": 1}", Fault::DuplicateKeys),
            (
                "[{\"x\": {\"a\": 1, \"b\": 2, \"a\": 3}}]",
                Fault::DuplicateKeys,
            ),
            ("[[[[1]]]]", Fault::TooDeep),
            ("{\"a\": [", Fault::Truncated),
            ("\"abc", Fault::Truncated),
            ("", Fault::Truncated),
            ("{'a': 1}", Fault::NotJson),
            ("{} x", Fault::NotJson),
            ("NaN", Fault::NotJson),
        ] {
            assert_eq!(read(text, 3), Err(fault), "{text}");
        }
    }

    #[test]
    fn a_hundred_thousand_brackets_are_too_deep() {
        assert_eq!(read(&"[".repeat(100_000), 32), Err(Fault::TooDeep));
    }

    #[test]
    fn the_end_of_the_first_value_is_returned() {
        let text = "{\"response\": 1}\nBecause.";
        let (_, end) = read_first(text, 4).expect("an object");
        assert_eq!(&text[end..], "\nBecause.");
    }
}
