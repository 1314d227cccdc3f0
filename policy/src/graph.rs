//! A graph of operators to a chain of layers, where it is one.

use std::collections::BTreeMap;

use crate::chain::{Shape, all_finite, wrong_shape};
use crate::constants::{float, floats, int, integers, is_row, transposed};
use crate::forward::LAYERS_MAX;
use crate::mlp::WIDTH_MAX;
use crate::onnx::{EXTERNAL, FLOAT, Graph, Node, Tensor, ValueInfo};
use crate::windows::Windows;
use crate::{Activation, Compression, Layer, Refusal, windows_graph};

/// The operators that a policy may use, all of ONNX's own domain. Those up to
/// `Tanh` are what the native runtime knows, `Mul`, `Add` and `Div` where they are a
/// [`Compression`] before the layers, and `Gather` and `Concat` where they belong to
/// [`Windows`]; the rest needs ONNX Runtime. There is no control flow,
/// no randomness and no reading of files among them.
pub const OPERATORS: &[&str] = &[
    "Gemm",
    "MatMul",
    "Add",
    "Flatten",
    "Identity",
    "Reshape",
    "Cast",
    "Constant",
    "Relu",
    "Tanh",
    "Abs",
    "AveragePool",
    "BatchNormalization",
    "Clip",
    "Concat",
    "Conv",
    "Div",
    "Dropout",
    "Elu",
    "Erf",
    "Exp",
    "Gather",
    "Gelu",
    "GlobalAveragePool",
    "HardSigmoid",
    "HardSwish",
    "LayerNormalization",
    "LeakyRelu",
    "Max",
    "MaxPool",
    "Min",
    "Mul",
    "Neg",
    "PRelu",
    "Pow",
    "ReduceMean",
    "Selu",
    "Sigmoid",
    "Slice",
    "Softmax",
    "Softplus",
    "Split",
    "Sqrt",
    "Squeeze",
    "Sub",
    "Transpose",
    "Unsqueeze",
];

/// Operators of a graph: far more than the layers of any small net need.
const NODES_MAX: usize = 1000;

/// The checks that hold for every graph and every back end.
///
/// # Errors
/// The first check that fails. Operators are checked before shapes and weights, which
/// have no meaning for an unknown operator.
pub fn check(graph: &Graph, shape: Shape) -> Result<(), Refusal> {
    if graph.node.len() > NODES_MAX {
        return Err(Refusal::TooMany {
            what: "operators",
            count: graph.node.len(),
            limit: NODES_MAX,
        });
    }
    for node in &graph.node {
        let is_own = matches!(node.domain.as_str(), "" | "ai.onnx");
        if !is_own || !OPERATORS.contains(&node.op_type.as_str()) {
            let domain = if is_own { "" } else { &node.domain };
            let dot = if is_own { "" } else { "." };
            let name = format!("{domain}{dot}{}", node.op_type);
            return Err(Refusal::UnknownOperator(name.chars().take(80).collect()));
        }
        if node
            .attribute
            .iter()
            .any(|a| a.g.is_some() || !a.graphs.is_empty())
        {
            return Err(Refusal::UnknownOperator(format!(
                "{} with a graph inside",
                node.op_type
            )));
        }
    }
    if !graph.sparse_initializer.is_empty() {
        return Err(Refusal::Graph("sparse weights are not supported".into()));
    }
    let constants = graph
        .node
        .iter()
        .flat_map(|node| &node.attribute)
        .filter_map(|attribute| attribute.t.as_ref());
    for tensor in graph.initializer.iter().chain(constants) {
        check_tensor(tensor)?;
    }
    let [_] = inputs(graph)[..] else {
        return Err(wrong_shape(
            "the graph",
            format!("{} inputs", inputs(graph).len()),
            format!("one, of {} numbers", shape.inputs),
        ));
    };
    let [output] = &graph.output[..] else {
        return Err(wrong_shape(
            "the graph",
            format!("{} outputs", graph.output.len()),
            format!("one, of {} numbers", shape.outputs),
        ));
    };
    check_value("the input", inputs(graph)[0], shape.inputs)?;
    check_value("the output", output, shape.outputs)
}

/// The inputs that are no constants: old exporters list those, too.
pub fn inputs(graph: &Graph) -> Vec<&ValueInfo> {
    let is_constant = |name: &str| graph.initializer.iter().any(|tensor| tensor.name == name);
    graph
        .input
        .iter()
        .filter(|input| !is_constant(&input.name))
        .collect()
}

/// How many numbers the graph's input has, if it says so.
pub fn width(graph: &Graph) -> Option<usize> {
    let [input] = inputs(graph)[..] else {
        return None;
    };
    let tensor = input.r#type.as_ref()?.tensor_type.as_ref()?;
    let last = tensor.shape.as_ref()?.dim.last()?.dim_value?;
    usize::try_from(last).ok()
}

/// One row, or a variable number of rows, of `width` 32-bit floats. A missing shape or
/// type is accepted.
fn check_value(what: &str, value: &ValueInfo, width: usize) -> Result<(), Refusal> {
    let tensor = value.r#type.as_ref().and_then(|t| t.tensor_type.as_ref());
    let Some(tensor) = tensor else {
        return Ok(());
    };
    if tensor.elem_type != FLOAT {
        let found = format!("elements of type {}", tensor.elem_type);
        return Err(wrong_shape(what, found, "32-bit floats (type 1)".into()));
    }
    let Some(shape) = &tensor.shape else {
        return Ok(());
    };
    let fits = match &shape.dim[..] {
        [.., last] if shape.dim.len() <= 2 => {
            let rows = match shape.dim.len() {
                2 => shape.dim[0].dim_value,
                _ => None,
            };
            matches!(rows, None | Some(0 | 1))
                && last.dim_value.is_none_or(|found| found == width as i64)
        }
        _ => false,
    };
    match fits {
        true => Ok(()),
        false => {
            let found = shape.dim.iter().take(8).map(|dim| match dim.dim_value {
                Some(value) => value.to_string(),
                None => "?".into(),
            });
            let found = format!("shape [{}]", found.collect::<Vec<_>>().join(", "));
            Err(wrong_shape(what, found, format!("[1, {width}]")))
        }
    }
}

fn check_tensor(tensor: &Tensor) -> Result<(), Refusal> {
    let name: String = tensor.name.chars().take(80).collect();
    if tensor.data_location == EXTERNAL {
        return Err(Refusal::Graph(format!(
            "the weights '{name}' are in another file; export with external_data=False"
        )));
    }
    let count = element_count(tensor).ok_or_else(|| {
        wrong_shape(
            &format!("the tensor '{name}'"),
            format!("dimensions {:?}", &tensor.dims[..tensor.dims.len().min(8)]),
            "a small number of elements".into(),
        )
    })?;
    if tensor.data_type != FLOAT {
        return Ok(());
    }
    let values = floats(tensor);
    if values.len() != count {
        return Err(wrong_shape(
            &format!("the tensor '{name}'"),
            format!("{} values", values.len()),
            format!("{count}, as its dimensions say"),
        ));
    }
    match all_finite(&values) {
        true => Ok(()),
        false => Err(Refusal::NotFinite(format!("a value of '{name}'"))),
    }
}

/// Elements by the dimensions; `None` for dimensions no weights have.
fn element_count(tensor: &Tensor) -> Option<usize> {
    const MOST: usize = WIDTH_MAX * WIDTH_MAX;
    tensor.dims.iter().try_fold(1_usize, |count, &dim| {
        let count = count.checked_mul(usize::try_from(dim).ok()?)?;
        (count <= MOST).then_some(count)
    })
}

/// What the native runtime runs.
#[derive(Default)]
pub struct Parts {
    /// What the inputs go through first.
    pub compression: Compression,
    /// The convolutions that follow.
    pub convolutions: Vec<Windows>,
    /// The layers behind them.
    pub layers: Vec<Layer>,
}

/// The parts of a graph that is a chain of them; `None` when it is something else, which is
/// no error: ONNX Runtime may know it.
///
/// # Errors
/// When it is such a chain, but not of the right shape.
pub fn parts(graph: &Graph, shape: Shape) -> Result<Option<Parts>, Refusal> {
    let Some((constants, operators)) = sorted(graph) else {
        return Ok(None);
    };
    let mut current = inputs(graph)[0].name.as_str();
    let mut width = shape.inputs;
    let Parts {
        mut compression,
        mut convolutions,
        mut layers,
    } = Parts::default();
    let mut rest = &operators[..];
    if let Some((found, output, behind)) = compressed(rest, current, &constants, width) {
        (compression, current, rest) = (found, output, behind);
    }
    while convolutions.len() < LAYERS_MAX
        && let Some((layer, output, behind)) = windows_graph::find(rest, current, &constants, width)
    {
        width = layer.outputs();
        convolutions.push(layer);
        (current, rest) = (output, behind);
    }
    for &(node, output) in rest {
        let Some(link) = link(node, current, &constants, (layers.last(), width)) else {
            return Ok(None);
        };
        match link {
            Link::Layer(layer) => {
                if layer.inputs != width {
                    return Err(wrong_shape(
                        &format!("the weights of layer {}", layers.len()),
                        format!("{} inputs", layer.inputs),
                        width.to_string(),
                    ));
                }
                if layers.len() == LAYERS_MAX {
                    return Ok(None);
                }
                width = layer.outputs;
                layers.push(layer);
            }
            Link::Bias(bias) if bias.len() == width => {
                let layer = layers.last_mut();
                let sums = layer.into_iter().flat_map(|layer| &mut layer.bias);
                sums.zip(bias).for_each(|(sum, bias)| *sum += bias);
            }
            Link::Bias(_) => return Ok(None),
            Link::Activation(activation) => match layers.last_mut() {
                Some(layer) => layer.activation = activation,
                None => return Ok(None),
            },
            Link::Nothing => {}
        }
        current = output;
    }
    let is_whole = graph
        .output
        .first()
        .is_some_and(|value| value.name == current);
    Ok((is_whole && !layers.is_empty()).then_some(Parts {
        compression,
        convolutions,
        layers,
    }))
}

/// The constants of a graph, by name.
pub type Constants<'a> = BTreeMap<&'a str, &'a Tensor>;
/// An operator with one output, and what that is called.
pub type Operator<'a> = (&'a Node, &'a str);

/// The constants of a graph and its other operators; `None` when one of them has not exactly
/// one output, or a constant is no tensor.
fn sorted(graph: &Graph) -> Option<(Constants<'_>, Vec<Operator<'_>>)> {
    let weights = graph.initializer.iter();
    let mut constants: Constants = weights
        .map(|tensor| (tensor.name.as_str(), tensor))
        .collect();
    let mut operators = Vec::new();
    for node in &graph.node {
        let [output] = &node.output[..] else {
            return None;
        };
        if node.op_type != "Constant" {
            operators.push((node, output.as_str()));
            continue;
        }
        let [attribute] = &node.attribute[..] else {
            return None;
        };
        constants.insert(output, attribute.t.as_ref()?);
    }
    Some((constants, operators))
}

/// The compression that the first operators make of the input, what its output is called,
/// and the operators behind it.
fn compressed<'a, 'b>(
    operators: &'b [Operator<'a>],
    input: &str,
    constants: &Constants,
    width: usize,
) -> Option<(Compression, &'a str, &'b [Operator<'a>])> {
    let [(mul, products), (add, divisors), (div, output), rest @ ..] = operators else {
        return None;
    };
    let takes = |node: &Node, operator: &str, first: &str| {
        let is_it = node.op_type == operator && node.input.len() == 2 && node.input[0] == first;
        is_it.then(|| node.input[1].clone())
    };
    let row = |name: &str| {
        let tensor = constants.get(name).filter(|tensor| is_row(tensor));
        tensor.map(|tensor| floats(tensor))
    };
    let slopes = row(&takes(mul, "Mul", input)?)?;
    let is_one = row(&takes(add, "Add", products)?)? == [1.0];
    let is_quotient = takes(div, "Div", input)? == *divisors;
    let from = slopes.iter().position(|slope| *slope != 0.0)?;
    let slope = slopes[from];
    let (mut others, to) = (slopes[from..].iter(), slopes.len());
    let to = others
        .position(|other| *other != slope)
        .map_or(to, |count| from + count);
    let is_same = slopes[to..].iter().all(|other| *other == 0.0);
    let is_known = is_one && is_quotient && is_same && slopes.len() == width;
    is_known.then_some((Compression { from, to, slope }, *output, rest))
}

/// What one operator adds to the chain.
enum Link {
    Layer(Layer),
    Bias(Vec<f32>),
    Activation(Activation),
    Nothing,
}

/// `None` when the operator does not continue the chain, or is not known here.
fn link(
    node: &Node,
    current: &str,
    constants: &Constants,
    (last, width): (Option<&Layer>, usize),
) -> Option<Link> {
    let inputs: Vec<&str> = node.input.iter().map(String::as_str).collect();
    let constant = |name: &str| constants.get(name).copied();
    let open = last.is_some_and(|layer| layer.activation == Activation::None);
    match (node.op_type.as_str(), &inputs[..]) {
        ("Gemm", [x, weights, bias @ ..]) if *x == current && bias.len() <= 1 => {
            let bias = match bias {
                [name] if !name.is_empty() => Some(constant(name)?),
                _ => None,
            };
            gemm(node, constant(weights)?, bias).map(Link::Layer)
        }
        ("MatMul", [x, weights]) if *x == current => {
            let weights = constant(weights)?;
            linear(weights, false, None).map(Link::Layer)
        }
        ("Add", [x, bias]) | ("Add", [bias, x]) if *x == current && open => {
            let bias = constant(bias)?;
            is_row(bias).then(|| Link::Bias(floats(bias)))
        }
        ("Relu", [x]) if *x == current && open => Some(Link::Activation(Activation::Relu)),
        ("Tanh", [x]) if *x == current && open => Some(Link::Activation(Activation::Tanh)),
        ("Identity", [x]) if *x == current => Some(Link::Nothing),
        ("Flatten", [x]) if *x == current && int(node, "axis", 1) == 1 => Some(Link::Nothing),
        ("Cast", [x]) if *x == current && int(node, "to", 0) == i64::from(FLOAT) => {
            Some(Link::Nothing)
        }
        ("Reshape", [x, shape]) if *x == current => {
            keeps_row(&integers(constant(shape)?), width as i64).then_some(Link::Nothing)
        }
        _ => None,
    }
}

/// A reshape to one row leaves the row.
fn keeps_row(shape: &[i64], width: i64) -> bool {
    let is_width = |dim: i64| dim == width || dim == -1;
    match *shape {
        [dim] => is_width(dim),
        [rows, dim] => (matches!(rows, 0 | 1) && is_width(dim)) || (rows == -1 && dim == width),
        _ => false,
    }
}

fn gemm(node: &Node, weights: &Tensor, bias: Option<&Tensor>) -> Option<Layer> {
    let is_plain = float(node, "alpha", 1.0) == 1.0
        && (bias.is_none() || float(node, "beta", 1.0) == 1.0)
        && int(node, "transA", 0) == 0;
    is_plain
        .then(|| linear(weights, int(node, "transB", 0) != 0, bias))
        .flatten()
}

/// A layer of `x W`, or of `x W'` when the weights are one row for each output.
fn linear(weights: &Tensor, rows_are_outputs: bool, bias: Option<&Tensor>) -> Option<Layer> {
    let [rows, columns] = weights.dims[..] else {
        return None;
    };
    let (rows, columns) = (usize::try_from(rows).ok()?, usize::try_from(columns).ok()?);
    if weights.data_type != FLOAT || rows == 0 || columns == 0 {
        return None;
    }
    let values = floats(weights);
    let (inputs, outputs, weights) = match rows_are_outputs {
        true => (columns, rows, values),
        false => (rows, columns, transposed(&values, columns)),
    };
    let bias = match bias {
        None => vec![0.0; outputs],
        Some(bias) if is_row(bias) => floats(bias),
        Some(_) => return None,
    };
    Some(Layer {
        weights,
        bias,
        inputs,
        outputs,
        activation: Activation::None,
    })
}
