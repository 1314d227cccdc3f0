use prost::Message;
use sha2::{Digest, Sha256};
use shm_config::message::{FEATURES, INPUTS_WITH_MOTION, WEIGHTS_BYTES_MAX};

use crate::chain::all_finite;
use crate::forward::ACTIONS;
use crate::metadata::{self, Probe, Provenance};
use crate::onnx::{
    ATTRIBUTE_INT, Attribute, Dimension, Entry, FLOAT, Graph, Model, Node, OperatorSet, Shape,
    Tensor, TensorType, Type, ValueInfo,
};
use crate::{Activation, Compression, Layer, Mlp, Refusal, Windows, graph, scan, windows_graph};

/// The default tolerance of a probe's answer: a hundred times the difference between
/// two orders of summation, a hundredth of what changes the driving.
pub const TOLERANCE: f32 = 1e-4;
/// Inputs that every net must answer with numbers, on top of the file's own
/// probes: all features at their ends and in the middle.
const CONSTANT_INPUTS: [f32; 3] = [0.0, 0.5, 1.0];

/// A policy file that passed every check except those of a foreign runtime.
#[derive(Debug, Clone)]
pub struct PolicyFile {
    /// What is to be run.
    pub net: Net,
    /// Who made it and how; `None` for a plain ONNX file.
    pub provenance: Option<Provenance>,
    /// Inputs and the outputs that the file says they have; empty for plain files.
    pub probes: Vec<Probe>,
    /// Of the whole file.
    pub sha256: [u8; 32],
}

/// What is to be run.
#[derive(Debug, Clone)]
pub enum Net {
    /// A chain of layers, with or without convolutions before it: the native runtime runs it,
    /// and ONNX Runtime could.
    Mlp {
        /// For the native runtime.
        mlp: Box<Mlp>,
        /// For ONNX Runtime.
        names: Names,
    },
    /// Another graph of allowed operators: only ONNX Runtime runs it.
    Graph(Names),
}

impl Net {
    /// How many numbers it takes.
    pub fn inputs(&self) -> usize {
        match self {
            Net::Mlp { mlp, .. } => mlp.inputs(),
            Net::Graph(names) => names.input_shape.last().map_or(0, |count| *count as usize),
        }
    }
}

/// What a graph calls its input and output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Names {
    /// The features.
    pub input: String,
    /// Elements of the input: `[1, 259]` or `[259]`; 379 with how bodies move.
    pub input_shape: Vec<i64>,
    /// The actions.
    pub output: String,
}

/// SHA-256 of a file.
pub fn sha256(bytes: &[u8]) -> [u8; 32] {
    Sha256::digest(bytes).into()
}

/// The first 8 bytes, as steps and statuses carry them; never 0, which means
/// that there are no weights.
pub fn short_hash(sha256: &[u8; 32]) -> u64 {
    let [first, ..] = sha256.as_chunks::<8>().0 else {
        return 1;
    };
    u64::from_be_bytes(*first).max(1)
}

/// The bytes have the claimed hash.
///
/// # Errors
/// [`Refusal::WrongHash`] when they are not.
pub fn check_hash(bytes: &[u8], claimed: &[u8; 32]) -> Result<(), Refusal> {
    let actual = sha256(bytes);
    match actual == *claimed {
        true => Ok(()),
        false => Err(Refusal::WrongHash {
            claimed: format!("{:016x}", short_hash(claimed)),
            actual: format!("{:016x}", short_hash(&actual)),
        }),
    }
}

/// Reads a policy file and makes every check that needs no foreign runtime: size,
/// format, layout, operators, shapes, finite weights, and for chains of layers
/// that the net answers its probes as the file says, within [`TOLERANCE`].
///
/// # Errors
/// The first check that fails.
pub fn decode(bytes: &[u8]) -> Result<PolicyFile, Refusal> {
    decode_within(bytes, TOLERANCE)
}

/// [`decode`] with the caller's tolerance.
///
/// # Errors
/// As [`decode`].
pub fn decode_within(bytes: &[u8], tolerance: f32) -> Result<PolicyFile, Refusal> {
    let (model, graph) = model(bytes)?;
    let shape = Mlp::shape(graph::width(&graph).unwrap_or(FEATURES));
    let (provenance, probes) = match metadata::read(&model.metadata_props, shape.inputs)? {
        Some((provenance, probes)) => (Some(provenance), probes),
        None => (None, Vec::new()),
    };
    graph::check(&graph, shape)?;
    let net = match graph::parts(&graph, shape)? {
        Some(parts) => {
            let (by, layers) = (parts.compression, parts.layers);
            let mut mlp = Mlp::convolved(by, parts.convolutions, layers)?;
            check_answers(&probes, tolerance, |features| mlp.infer(features))?;
            Net::Mlp {
                mlp: Box::new(mlp),
                names: names(&graph, shape.inputs),
            }
        }
        None => Net::Graph(names(&graph, shape.inputs)),
    };
    // Last: the checks before it name the fault more exactly.
    metadata::check_graph(&model.metadata_props, || graph_hash(&graph))?;
    Ok(PolicyFile {
        net,
        provenance,
        probes,
        sha256: sha256(bytes),
    })
}

/// The message of a file and its graph, after the checks of size and format.
///
/// # Errors
/// The first check that fails.
pub(crate) fn model(bytes: &[u8]) -> Result<(Model, Graph), Refusal> {
    if bytes.is_empty() {
        return Err(Refusal::Empty);
    }
    if bytes.len() > WEIGHTS_BYTES_MAX {
        return Err(Refusal::TooLarge {
            bytes: bytes.len() as u64,
            limit: WEIGHTS_BYTES_MAX as u64,
        });
    }
    scan::scan(bytes)?;
    let mut model = Model::decode(bytes).map_err(|_| Refusal::NotOnnx("a field is broken"))?;
    let Some(graph) = model.graph.take() else {
        return Err(match model.ir_version {
            0 => Refusal::NotOnnx("it has neither a version nor a graph"),
            _ => Refusal::Truncated("its head: no graph follows"),
        });
    };
    if !model.functions.is_empty() {
        return Err(Refusal::UnknownOperator(
            "a function of the file's own".into(),
        ));
    }
    Ok((model, graph))
}

/// A net answers with finite numbers, and answers its probes as the file says. A caller
/// that runs a [`Net::Graph`] calls it; [`decode`] has called it for the other nets.
///
/// # Errors
/// [`Refusal::NotFinite`] or [`Refusal::ProbeMismatch`].
pub fn check_answers(
    probes: &[Probe],
    tolerance: f32,
    mut infer: impl FnMut(&[f32]) -> [f32; ACTIONS],
) -> Result<(), Refusal> {
    for value in CONSTANT_INPUTS {
        if !all_finite(&infer(&[value; INPUTS_WITH_MOTION])) {
            return Err(Refusal::NotFinite(format!(
                "the answer to features that are all {value}"
            )));
        }
    }
    for (k, probe) in probes.iter().enumerate() {
        let answered = infer(&probe.features);
        // In this form NaN is not near.
        let is_near = |k: usize| (answered[k] - probe.action[k]).abs() <= tolerance;
        if !(is_near(0) && is_near(1)) {
            return Err(Refusal::ProbeMismatch {
                probe: k,
                answered,
                expected: probe.action,
                tolerance,
            });
        }
    }
    Ok(())
}

fn names(graph: &Graph, inputs: usize) -> Names {
    let input = graph::inputs(graph)[0];
    let shape = input
        .r#type
        .as_ref()
        .and_then(|t| t.tensor_type.as_ref())
        .and_then(|tensor| tensor.shape.as_ref());
    let is_flat = shape.is_some_and(|shape| shape.dim.len() == 1);
    Names {
        input: input.name.clone(),
        input_shape: match is_flat {
            true => vec![inputs as i64],
            false => vec![1, inputs as i64],
        },
        output: graph.output[0].name.clone(),
    }
}

/// IR version 8 with operator set 13: read by everything since 2021.
const IR_VERSION: i64 = 8;
const OPERATOR_SET: i64 = 13;

/// A policy file of a net: ONNX with the metadata of
/// [`Provenance`], and these probes with the answers of the native runtime. A
/// probe of another length than the net's input is filled with zeros or cut.
///
/// The graph comes last, after the metadata: a truncated file has no complete graph, and
/// is never mistaken for a file without metadata.
pub fn encode(mlp: &Mlp, provenance: &Provenance, probes: &[Vec<f32>]) -> Vec<u8> {
    let mut runtime = mlp.clone();
    let probes: Vec<Probe> = probes
        .iter()
        .map(|features| {
            let mut features = features.clone();
            features.resize(mlp.inputs(), 0.0);
            let action = runtime.infer(&features);
            Probe { features, action }
        })
        .collect();
    let ends = Ends {
        name: "policy",
        input: "features",
        output: "action",
    };
    let before = (mlp.compression(), mlp.convolutions());
    let graph = graph_of(before, mlp.layers(), &ends);
    let about = (provenance, mlp.inputs());
    let entries = metadata::write(about, &probes, &graph_hash(&graph));
    joined(entries, graph)
}

/// The bytes of a file: the metadata, then the graph.
pub(crate) fn joined(metadata_props: Vec<Entry>, graph: Graph) -> Vec<u8> {
    let head = Model {
        ir_version: IR_VERSION,
        producer_name: "vlaps".into(),
        producer_version: env!("CARGO_PKG_VERSION").into(),
        opset_import: vec![OperatorSet {
            domain: String::new(),
            version: OPERATOR_SET,
        }],
        metadata_props,
        ..Model::default()
    };
    let tail = Model {
        graph: Some(graph),
        ..Model::default()
    };
    // Messages that follow each other are one message.
    let mut bytes = head.encode_to_vec();
    bytes.extend(tail.encode_to_vec());
    bytes
}

/// What a graph, its input and its output are called.
pub(crate) struct Ends<'a> {
    pub name: &'a str,
    pub input: &'a str,
    pub output: &'a str,
}

/// SHA-256 of a graph as this crate encodes it, hex.
pub(crate) fn graph_hash(graph: &Graph) -> String {
    let hash = sha256(&graph.encode_to_vec());
    hash.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The graph of a compression, convolutions and layers that follow on each other.
pub(crate) fn graph_of(
    (compression, convolutions): (Compression, &[Windows]),
    layers: &[Layer],
    ends: &Ends,
) -> Graph {
    let first = layers.first().map_or(0, |layer| layer.inputs);
    let inputs = convolutions.first().map_or(first, |layer| layer.inputs);
    let outputs = layers.last().map_or(0, |layer| layer.outputs);
    let mut graph = Graph {
        name: ends.name.into(),
        input: vec![row(ends.input, inputs)],
        output: vec![row(ends.output, outputs)],
        ..Graph::default()
    };
    let mut current = match compression.slope == 0.0 {
        true => ends.input.to_string(),
        false => compress(&mut graph, ends.input, (compression, inputs)),
    };
    for (k, layer) in convolutions.iter().enumerate() {
        current = windows_graph::add(&mut graph, k, &current, layer);
    }
    let last = layers.len().saturating_sub(1);
    for (k, layer) in layers.iter().enumerate() {
        let name = |what: &str, is_end: bool| match is_end && k == last {
            true => ends.output.into(),
            false => format!("layer{k}.{what}"),
        };
        let activation = match layer.activation {
            Activation::None => None,
            Activation::Relu => Some("Relu"),
            Activation::Tanh => Some("Tanh"),
        };
        let (weights, bias) = (format!("layer{k}.weight"), format!("layer{k}.bias"));
        let sums = name("sums", activation.is_none());
        graph.node.push(Node {
            input: vec![current, weights.clone(), bias.clone()],
            output: vec![sums.clone()],
            op_type: "Gemm".into(),
            attribute: vec![Attribute {
                name: "transB".into(),
                i: 1,
                kind: ATTRIBUTE_INT,
                ..Attribute::default()
            }],
            ..Node::default()
        });
        let dims = [layer.outputs as i64, layer.inputs as i64];
        graph
            .initializer
            .push(tensor(weights, &dims, &layer.weights));
        graph
            .initializer
            .push(tensor(bias, &dims[..1], &layer.bias));
        current = match activation {
            None => sums,
            Some(operator) => {
                let output = name("output", true);
                graph.node.push(Node {
                    input: vec![sums],
                    output: vec![output.clone()],
                    op_type: operator.into(),
                    ..Node::default()
                });
                output
            }
        };
    }
    graph
}

/// Adds the operators of the compression of this input; returns what their output is called.
fn compress(graph: &mut Graph, input: &str, (by, width): (Compression, usize)) -> String {
    let name = |what: &str| format!("compression.{what}");
    let mut slopes = vec![0.0; width];
    slopes
        .iter_mut()
        .take(by.to)
        .skip(by.from)
        .for_each(|slope| *slope = by.slope);
    graph
        .initializer
        .push(tensor(name("slopes"), &[width as i64], &slopes));
    graph.initializer.push(tensor(name("one"), &[1], &[1.0]));
    for (operator, inputs, output) in [
        ("Mul", [input.into(), name("slopes")], "products"),
        ("Add", [name("products"), name("one")], "divisors"),
        ("Div", [input.into(), name("divisors")], "output"),
    ] {
        graph.node.push(Node {
            input: inputs.to_vec(),
            output: vec![name(output)],
            op_type: operator.into(),
            ..Node::default()
        });
    }
    name("output")
}

pub(crate) fn tensor(name: String, dims: &[i64], values: &[f32]) -> Tensor {
    Tensor {
        dims: dims.to_vec(),
        data_type: FLOAT,
        name,
        raw_data: values
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect(),
        ..Tensor::default()
    }
}

fn row(name: &str, width: usize) -> ValueInfo {
    let dim = |value: i64| Dimension {
        dim_value: Some(value),
        dim_param: None,
    };
    ValueInfo {
        name: name.into(),
        r#type: Some(Type {
            tensor_type: Some(TensorType {
                elem_type: FLOAT,
                shape: Some(Shape {
                    dim: vec![dim(1), dim(width as i64)],
                }),
            }),
        }),
    }
}
