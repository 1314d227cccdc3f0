//! A scan of the bytes before they are decoded. It refuses bytes that are not an ONNX
//! file, are truncated, or would decode into far more memory than they take.

use crate::Refusal;

/// Parts of a file: operators, names, constants, dimensions. An exported net of
/// sixteen layers has a few hundred; decoded, each takes up to 200 bytes.
const PARTS_MAX: usize = 20_000;

/// A message of [`crate::onnx`], or anything else.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Model,
    Graph,
    Node,
    Attribute,
    Tensor,
    ValueInfo,
    Type,
    TensorType,
    Shape,
    Leaf,
}

impl Kind {
    /// What a field of this message holds.
    fn field(self, number: u64) -> Kind {
        match (self, number) {
            (Kind::Model, 7) => Kind::Graph,
            (Kind::Graph, 1) => Kind::Node,
            (Kind::Graph, 5) => Kind::Tensor,
            (Kind::Graph, 11 | 12) => Kind::ValueInfo,
            (Kind::Node, 5) => Kind::Attribute,
            (Kind::Attribute, 5) => Kind::Tensor,
            (Kind::ValueInfo, 2) => Kind::Type,
            (Kind::Type, 1) => Kind::TensorType,
            (Kind::TensorType, 2) => Kind::Shape,
            _ => Kind::Leaf,
        }
    }

    fn name(self, number: u64) -> &'static str {
        match (self, number) {
            (Kind::Model, 7) => "the graph",
            (Kind::Model, 8) => "the operator set",
            (Kind::Model, 14) => "the metadata",
            _ => "its head",
        }
    }
}

/// Which fields `ModelProto` has, and how each is encoded.
fn is_model_field(number: u64, encoding: u64) -> bool {
    match number {
        1 | 5 => encoding == 0,
        2 | 3 | 4 | 6 | 7 | 8 | 14 | 20 | 25 | 26 => encoding == 2,
        _ => false,
    }
}

/// The bytes can be decoded without harm.
pub fn scan(bytes: &[u8]) -> Result<(), Refusal> {
    let mut parts = 0;
    walk(bytes, Kind::Model, &mut parts)
}

fn walk(bytes: &[u8], kind: Kind, parts: &mut usize) -> Result<(), Refusal> {
    let is_model = kind == Kind::Model;
    let mut rest = bytes;
    let mut fields = 0;
    while !rest.is_empty() {
        // An ONNX file has no magic number: a valid first field of a model makes it
        // one, and any later fault means that it is truncated.
        let ended = |number| match is_model && fields > 0 {
            true => Refusal::Truncated(kind.name(number)),
            false => Refusal::NotOnnx("a field is longer than what holds it"),
        };
        let key = varint(&mut rest).ok_or_else(|| ended(0))?;
        let (number, encoding) = (key >> 3, key & 7);
        if is_model && !is_model_field(number, encoding) {
            return Err(Refusal::NotOnnx("it has fields that no model has"));
        }
        let length = match encoding {
            0 => varint(&mut rest).map(|_| 0),
            1 => Some(8),
            2 => varint(&mut rest),
            5 => Some(4),
            _ => return Err(Refusal::NotOnnx("a field of unknown encoding")),
        };
        let length = length.ok_or_else(|| ended(number))?;
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        let (inside, behind) = rest.split_at_checked(length).ok_or_else(|| ended(number))?;
        rest = behind;
        fields += 1;
        if encoding == 2 {
            *parts += 1;
            if *parts > PARTS_MAX {
                return Err(Refusal::TooMany {
                    what: "parts of the file",
                    count: *parts,
                    limit: PARTS_MAX,
                });
            }
            match kind.field(number) {
                Kind::Leaf => {}
                // As deep as the list of kinds, no deeper.
                inner => walk(inside, inner, parts)?,
            }
        }
    }
    Ok(())
}

/// The next number; `None` at the end of the bytes or over 64 bits.
fn varint(rest: &mut &[u8]) -> Option<u64> {
    let mut value = 0;
    for k in 0..10 {
        let (&byte, behind) = rest.split_first()?;
        *rest = behind;
        value |= u64::from(byte & 0x7f) << (7 * k);
        if byte < 0x80 {
            return Some(value);
        }
    }
    None
}
