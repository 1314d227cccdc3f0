//! Files of other nets than policies: the same format, checks and operators, a kind of
//! their own and metadata of the caller's.

use std::collections::BTreeMap;

use crate::chain::{Chain, Shape, all_finite, wrong_shape};
use crate::file::{Ends, graph_hash, graph_of, joined, model};
use crate::onnx::Entry;
use crate::{Compression, Refusal, graph, metadata};

/// What a file of this kind holds.
#[derive(Debug, Clone)]
pub struct ChainFile {
    /// The net.
    pub chain: Chain,
    /// The metadata, without the prefix `vlaps.`.
    pub metadata: BTreeMap<String, String>,
}

/// The key that says what a file is for; a policy has none.
pub(crate) const KIND_KEY: &str = "kind";

/// The bytes of a file of this kind, with these keys and values beside the net. The graph
/// comes last, so that a truncated file has no complete graph.
pub fn encode_chain(kind: &str, chain: &Chain, entries: &[(&str, String)]) -> Vec<u8> {
    let ends = Ends {
        name: kind,
        input: "question",
        output: "answer",
    };
    let graph = graph_of((Compression::default(), &[]), chain.layers(), &ends);
    let own = [
        (KIND_KEY, kind.to_string()),
        (metadata::GRAPH_KEY, graph_hash(&graph)),
    ];
    let entries = own.iter().chain(entries).map(|(key, value)| Entry {
        key: format!("{}{key}", metadata::PREFIX),
        value: value.clone(),
    });
    joined(entries.collect(), graph)
}

/// Reads a file of this kind and makes every check: size, format, kind, operators,
/// shapes, finite weights, and that the graph is the one that was written. `shape` gives
/// the net's shape by the metadata, and may refuse them.
///
/// # Errors
/// The first check that fails.
pub fn decode_chain(
    kind: &str,
    bytes: &[u8],
    shape: impl FnOnce(&BTreeMap<String, String>) -> Result<Shape, Refusal>,
) -> Result<ChainFile, Refusal> {
    let (model, graph) = model(bytes)?;
    let own = |entry: &Entry| {
        let key = entry.key.strip_prefix(metadata::PREFIX)?;
        Some((key.to_string(), entry.value.clone()))
    };
    let metadata: BTreeMap<_, _> = model.metadata_props.iter().filter_map(own).collect();
    let found = metadata.get(KIND_KEY).map_or("policy", String::as_str);
    if found != kind {
        return Err(wrong_kind(found, kind));
    }
    let shape = shape(&metadata)?;
    graph::check(&graph, shape)?;
    let is_plain = |parts: &graph::Parts| {
        parts.compression == Compression::default() && parts.convolutions.is_empty()
    };
    let layers = graph::parts(&graph, shape)?
        .filter(is_plain)
        .map(|parts| parts.layers)
        .ok_or_else(|| Refusal::Graph("its operators are no chain of layers".into()))?;
    let mut chain = Chain::new(layers, shape)?;
    for value in [-1.0, 0.0, 1.0] {
        if !all_finite(chain.infer(&vec![value; shape.inputs])) {
            let what = format!("the answer to inputs that are all {value}");
            return Err(Refusal::NotFinite(what));
        }
    }
    if !metadata.contains_key(metadata::GRAPH_KEY) {
        return Err(metadata::broken(metadata::GRAPH_KEY, "is missing"));
    }
    metadata::check_graph(&model.metadata_props, || graph_hash(&graph))?;
    Ok(ChainFile { chain, metadata })
}

/// The refusal of a file for another purpose.
pub(crate) fn wrong_kind(found: &str, expected: &str) -> Refusal {
    let shown: String = found.chars().take(40).collect();
    wrong_shape("the file's kind", shown, expected.into())
}
