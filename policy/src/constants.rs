//! Reads the constants and attributes of a graph.

use crate::onnx::{ATTRIBUTE_INT, FLOAT, INT64, Node, Tensor};

/// The values of a tensor of floats.
pub fn floats(tensor: &Tensor) -> Vec<f32> {
    if !tensor.float_data.is_empty() {
        return tensor.float_data.clone();
    }
    let values = tensor.raw_data.as_chunks::<4>().0.iter();
    values.map(|bytes| f32::from_le_bytes(*bytes)).collect()
}

/// Columns become rows.
pub fn transposed(values: &[f32], columns: usize) -> Vec<f32> {
    let column = |k: usize| values.iter().skip(k).step_by(columns);
    (0..columns).flat_map(column).copied().collect()
}

/// `[n]` or `[1, n]` floats.
pub fn is_row(tensor: &Tensor) -> bool {
    tensor.data_type == FLOAT && matches!(tensor.dims[..], [_] | [1, _])
}

/// The values of a tensor of whole numbers.
pub fn integers(tensor: &Tensor) -> Vec<i64> {
    if tensor.data_type != INT64 {
        return Vec::new();
    }
    if !tensor.int64_data.is_empty() {
        return tensor.int64_data.clone();
    }
    let values = tensor.raw_data.as_chunks::<8>().0.iter();
    values.map(|bytes| i64::from_le_bytes(*bytes)).collect()
}

/// A whole attribute of an operator.
pub fn int(node: &Node, name: &str, default: i64) -> i64 {
    let found = node
        .attribute
        .iter()
        .find(|a| a.name == name && a.kind == ATTRIBUTE_INT);
    found.map_or(default, |attribute| attribute.i)
}

/// Another attribute of an operator.
pub fn float(node: &Node, name: &str, default: f32) -> f32 {
    let found = node.attribute.iter().find(|a| a.name == name);
    found.map_or(default, |attribute| attribute.f)
}
