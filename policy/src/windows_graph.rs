//! Convolutions as ONNX operators, and back.
//!
//! `Gather` takes the numbers that are passed on and those of all windows, `MatMul`, `Add` and
//! `Relu` make each window's answers, and `Concat` puts both into one row.

use crate::constants::{floats, int, integers, is_row, transposed};
use crate::graph::{Constants, Operator};
use crate::onnx::{ATTRIBUTE_INT, Attribute, FLOAT, Graph, INT64, Node, Tensor};
use crate::windows::Windows;

/// Operators of one convolution.
const NODES: usize = 7;

/// Adds the operators of this convolution, whose names begin with `convolutionK`; returns what
/// their output is called.
pub fn add(graph: &mut Graph, k: usize, input: &str, layer: &Windows) -> String {
    let name = |what: &str| format!("convolution{k}.{what}");
    let (window, filters) = (layer.window, layer.filters());
    let kept: Vec<i64> = (0..layer.kept as i64).collect();
    let indices: Vec<i64> = layer
        .indices
        .iter()
        .map(|index| i64::from(*index))
        .collect();
    let shape = [layer.positions() as i64, window as i64];
    let row = [1, (layer.positions() * filters) as i64];
    graph.initializer.extend([
        whole(name("first"), &[kept.len() as i64], &kept),
        whole(name("indices"), &shape, &indices),
        crate::file::tensor(
            name("weight"),
            &[window as i64, filters as i64],
            &transposed(&layer.weights, window),
        ),
        crate::file::tensor(name("bias"), &[filters as i64], &layer.bias),
        whole(name("row"), &[2], &row),
    ]);
    let nodes: [(&str, &[&str], &str); NODES] = [
        ("Gather", &["", "first"], "kept"),
        ("Gather", &["", "indices"], "windows"),
        ("MatMul", &["windows", "weight"], "products"),
        ("Add", &["products", "bias"], "sums"),
        ("Relu", &["sums"], "answers"),
        ("Reshape", &["answers", "row"], "flat"),
        ("Concat", &["kept", "flat"], "output"),
    ];
    for (operator, inputs, output) in nodes {
        let inputs = inputs.iter().map(|what| match *what {
            "" => input.to_string(),
            what => name(what),
        });
        let axis = Attribute {
            name: "axis".into(),
            i: 1,
            kind: ATTRIBUTE_INT,
            ..Attribute::default()
        };
        let has_axis = matches!(operator, "Gather" | "Concat");
        graph.node.push(Node {
            input: inputs.collect(),
            output: vec![name(output)],
            op_type: operator.into(),
            attribute: has_axis.then_some(axis).into_iter().collect(),
            ..Node::default()
        });
    }
    name("output")
}

/// The convolution that the first operators make of `input`, `width` numbers, what its output
/// is called, and the operators behind it; `None` when they are something else.
pub fn find<'a, 'b>(
    operators: &'b [Operator<'a>],
    input: &str,
    constants: &Constants,
    width: usize,
) -> Option<(Windows, &'a str, &'b [Operator<'a>])> {
    let (own, rest) = operators.split_at_checked(NODES)?;
    let [first, windows, products, sums, answers, flat, output] = own else {
        return None;
    };
    let takes = |(node, _): &Operator, operator: &str, first: &str| {
        let is_it = node.op_type == operator && node.input.first()? == first;
        is_it.then(|| node.input.get(1).cloned().unwrap_or_default())
    };
    let constant = |name: String| constants.get(name.as_str()).copied();
    let is_along_row = |(node, _): &Operator| int(node, "axis", 0) == 1;
    let kept = integers(constant(takes(first, "Gather", input)?)?);
    let places = constant(takes(windows, "Gather", input)?)?;
    // Of floats alone it is known that there are as many as the sizes say.
    let weights = constant(takes(products, "MatMul", windows.1)?)?;
    let weights = Some(weights).filter(|tensor| tensor.data_type == FLOAT)?;
    let bias = constant(takes(sums, "Add", products.1)?)?;
    takes(answers, "Relu", sums.1)?;
    let row = integers(constant(takes(flat, "Reshape", answers.1)?)?);
    let joined = takes(output, "Concat", first.1)?;
    let sizes = |tensor: &Tensor| match tensor.dims[..] {
        [rows, columns] => Some([usize::try_from(rows).ok()?, usize::try_from(columns).ok()?]),
        _ => None,
    };
    let ([positions, window], [rows, filters]) = (sizes(places)?, sizes(weights)?);
    let indices = integers(places).into_iter().map(u32::try_from);
    let layer = Windows {
        inputs: width,
        kept: kept.len(),
        window,
        indices: indices.collect::<Result<_, _>>().ok()?,
        weights: transposed(&floats(weights), filters),
        bias: floats(bias),
    };
    let answers = positions.checked_mul(filters)?;
    let is_first = kept.iter().copied().eq(0..kept.len() as i64);
    let is_known = is_first
        && joined == flat.1
        && output.0.input.len() == 2
        && window == rows
        && is_row(bias)
        && layer.filters() == filters
        && Some(layer.indices.len()) == positions.checked_mul(window)
        && row == [1, answers as i64]
        && [first, windows, output].into_iter().all(is_along_row);
    is_known.then_some((layer, output.1, rest))
}

/// A constant of whole numbers.
fn whole(name: String, dims: &[i64], values: &[i64]) -> Tensor {
    let bytes = values.iter().flat_map(|value| value.to_le_bytes());
    Tensor {
        dims: dims.to_vec(),
        data_type: INT64,
        name,
        raw_data: bytes.collect(),
        ..Tensor::default()
    }
}
