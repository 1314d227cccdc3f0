use shm_config::message::{INPUTS_WITH_MOTION, MOTION_LAYOUT, OBSERVATION_LAYOUT};

use crate::Refusal;
use crate::chain::all_finite;
use crate::chain_file::{KIND_KEY, wrong_kind};
use crate::forward::ACTIONS;
use crate::onnx::Entry;

/// The format that this crate writes, and the only one it reads.
pub const FORMAT_VERSION: u32 = 1;
/// Most probes of a file.
pub const PROBES_MAX: usize = 64;

/// The prefix of our keys; keys without it belong to the exporter and are ignored.
pub(crate) const PREFIX: &str = "vlaps.";

/// The key of the graph's hash; older files do not have it.
pub(crate) const GRAPH_KEY: &str = "graph_sha256";

/// How a net was made.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Provenance {
    /// Such as `pvp` or `bc`.
    pub algorithm: String,
    /// Of the training.
    pub seed: u64,
    /// Steps driven in training.
    pub steps: u64,
    /// Commit of the program that trained.
    pub commit: String,
}

/// An input with the output that the file says it has.
#[derive(Debug, Clone, PartialEq)]
pub struct Probe {
    /// As many features as the net takes.
    pub features: Vec<f32>,
    /// Steering and pedal.
    pub action: [f32; ACTIONS],
}

/// The metadata of a file whose net takes so many inputs; `graph` is the hash of its graph.
pub fn write(
    (provenance, inputs): (&Provenance, usize),
    probes: &[Probe],
    graph: &str,
) -> Vec<Entry> {
    let entry = |key: &str, value: String| Entry {
        key: format!("{PREFIX}{key}"),
        value,
    };
    let rows = |row: fn(&Probe) -> &[f32]| {
        let rows = probes.iter().map(|probe| {
            let numbers: Vec<_> = row(probe).iter().map(f32::to_string).collect();
            numbers.join(",")
        });
        rows.collect::<Vec<_>>().join(";")
    };
    vec![
        entry("format", FORMAT_VERSION.to_string()),
        entry("observation_layout", layout_word(inputs)),
        entry("algorithm", provenance.algorithm.clone()),
        entry("seed", provenance.seed.to_string()),
        entry("steps", provenance.steps.to_string()),
        entry("commit", provenance.commit.clone()),
        entry(GRAPH_KEY, graph.into()),
        entry("probe_inputs", rows(|probe| &probe.features)),
        entry("probe_outputs", rows(|probe| &probe.action)),
    ]
}

/// The graph of a file is the one that was written.
///
/// # Errors
/// When its hash differs from the metadata's. A file without that key is accepted.
pub fn check_graph(entries: &[Entry], hash: impl FnOnce() -> String) -> Result<(), Refusal> {
    let Ok(claimed) = text(entries, GRAPH_KEY) else {
        return Ok(());
    };
    let actual = hash();
    match actual == claimed {
        true => Ok(()),
        false => Err(Refusal::ChangedGraph {
            claimed: short(claimed),
            actual: short(&actual),
        }),
    }
}

/// The feature map of a net that takes so many inputs.
fn layout_word(inputs: usize) -> String {
    let layout = match inputs {
        INPUTS_WITH_MOTION => MOTION_LAYOUT,
        _ => OBSERVATION_LAYOUT,
    };
    format!("{layout:016x}")
}

/// The metadata of a file whose net takes so many inputs; `None` when it has none of our keys.
///
/// # Errors
/// When some keys are missing, a value cannot be read, or the format or observation
/// layout is another.
pub fn read(entries: &[Entry], inputs: usize) -> Result<Option<(Provenance, Vec<Probe>)>, Refusal> {
    if !entries.iter().any(|entry| entry.key.starts_with(PREFIX)) {
        return Ok(None);
    }
    if let Ok(kind) = text(entries, KIND_KEY) {
        return Err(wrong_kind(kind, "policy"));
    }
    let format = number(entries, "format")?;
    if format != u64::from(FORMAT_VERSION) {
        return Err(broken(
            "format",
            &format!("format {format}, this build reads {FORMAT_VERSION}"),
        ));
    }
    let theirs = text(entries, "observation_layout")?;
    let ours = layout_word(inputs);
    if theirs != ours {
        return Err(Refusal::WrongLayout {
            theirs: short(theirs),
            ours,
        });
    }
    let provenance = Provenance {
        algorithm: text(entries, "algorithm")?.into(),
        seed: number(entries, "seed")?,
        steps: number(entries, "steps")?,
        commit: text(entries, "commit")?.into(),
    };
    let inputs = rows(entries, "probe_inputs", inputs)?;
    let outputs = rows(entries, "probe_outputs", ACTIONS)?;
    if inputs.len() != outputs.len() {
        return Err(broken(
            "probe_outputs",
            &format!("{} probes, but {} inputs", outputs.len(), inputs.len()),
        ));
    }
    let probes = inputs.into_iter().zip(outputs).map(|(features, output)| {
        let mut action = [0.0; ACTIONS];
        action.copy_from_slice(&output);
        Probe { features, action }
    });
    Ok(Some((provenance, probes.collect())))
}

fn short(text: &str) -> String {
    text.chars().take(40).collect()
}

pub(crate) fn broken(key: &str, what: &str) -> Refusal {
    Refusal::Metadata {
        key: format!("{PREFIX}{key}"),
        what: what.into(),
    }
}

fn text<'a>(entries: &'a [Entry], key: &str) -> Result<&'a str, Refusal> {
    let entry = entries
        .iter()
        .find(|entry| entry.key.strip_prefix(PREFIX) == Some(key));
    entry
        .map(|entry| entry.value.as_str())
        .ok_or_else(|| broken(key, "is missing"))
}

fn number(entries: &[Entry], key: &str) -> Result<u64, Refusal> {
    let text = text(entries, key)?;
    text.parse()
        .map_err(|_| broken(key, &format!("{:?} is no whole number", short(text))))
}

/// Rows of `width` finite numbers.
fn rows(entries: &[Entry], key: &str, width: usize) -> Result<Vec<Vec<f32>>, Refusal> {
    let text = text(entries, key)?;
    if text.is_empty() {
        return Ok(Vec::new());
    }
    let count = text.split(';').count();
    if count > PROBES_MAX {
        return Err(Refusal::TooMany {
            what: "probes",
            count,
            limit: PROBES_MAX,
        });
    }
    let row = |text: &str| {
        let numbers: Result<Vec<f32>, _> = text.split(',').map(str::parse).collect();
        let numbers = numbers.map_err(|_| broken(key, "holds something else than numbers"))?;
        if numbers.len() != width || !all_finite(&numbers) {
            let what = format!("a row must be {width} finite numbers");
            return Err(broken(key, &what));
        }
        Ok(numbers)
    };
    text.split(';').map(row).collect()
}
