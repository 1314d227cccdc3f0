//! `bench policy`: inference time of a policy's network, by back end.

use crate::gauges::Gauges;
use clap::Args;
use std::path::PathBuf;
use std::process::Command;
use std::process::ExitCode;
use std::time::Duration;
use supervisor::cli::parsers::whole;
use supervisor::subcommand::{Output, Subcommand};

use anyhow::{Context, bail};
use controller::{OrtPolicy, OrtSession, Policy, library};
use hdrhistogram::Histogram;
use learner::algorithm::{Size, actor};
use learner::{Rate, export};
use policy::{Activation, Layer, Mlp, Net, Provenance, decode, encode};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::Serialize;
use shm_config::message::{FEATURES, INPUTS_WITH_MOTION};

use lab::report::{Machine, table};
use stack::Clock;
use supervisor::subcommand::{say, write_json_option};

/// Measure the inference time of a policy's network, by back end.
#[derive(Debug, Args)]
#[command(
    after_help = "Rows: the bare matrix products of the same size (the lower limit), the native \
        runtime, ONNX Runtime (after ./vlaps setup onnxruntime), and PyTorch if the Python has it.\n\n\
        Examples:\n  \
        ./vlaps bench policy\n  \
        ./vlaps bench policy --python torch/bin/python --json policy.json"
)]
pub struct BenchPolicy {
    /// Number of measured inferences per back end.
    #[arg(long, value_name = "N", default_value_t = 20_000,
          allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=10_000_000))]
    pub runs: u32,
    /// libonnxruntime.so or its folder; default: that of ./vlaps setup onnxruntime.
    #[arg(long, value_name = "FILE")]
    pub onnxruntime: Option<PathBuf>,
    /// A Python with PyTorch; default: python3.
    #[arg(long, value_name = "FILE")]
    pub python: Option<PathBuf>,
    /// Also write the rows to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for BenchPolicy {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let gauges = Gauges::new(clock);
        let conditions = Machine::here()?;
        let mlp = net(HIDDEN, 1);
        let features: Vec<f32> = (0..FEATURES)
            .map(|k| (k as f32 * 0.1).sin().abs())
            .collect();
        let bytes = encode(
            &mlp,
            &Provenance::default(),
            std::slice::from_ref(&features),
        );
        let meter = Meter {
            gauges,
            runs: self.runs,
            features,
        };
        let mut rows = vec![
            bare(&mlp, &meter),
            native("native, in the tick", &mlp, &meter),
            native("the same, beams compressed", &compressed(&mlp), &meter),
            native("native, 379-512-512-2", &trained(0)?, &meter),
            native("the same behind 32 filters", &trained(32)?, &meter),
        ];
        rows.extend(onnx_runtime(self, &bytes, &mlp, &meter)?);
        rows.push(pytorch(self, &meter));
        let results = PolicyResults {
            rows,
            net: "259-256-256-2, ReLU, tanh at the end",
            runs: self.runs,
            conditions,
        };
        print(&results);
        write_json_option(&self.json, &results)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Width of the two hidden layers: that of the experiment's actor.
const HIDDEN: usize = 256;
/// Inferences before the measurement.
const WARM_UP: u32 = 1000;
/// Number of outputs whose sums the bare product keeps in registers.
const BLOCK: usize = 64;
/// Time limit for ONNX Runtime in its own thread: longer than any tick.
const PATIENCE: Duration = Duration::from_millis(100);

/// Inference time of one back end.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name of the back end.
    pub backend: &'static str,
    /// Median time, us.
    pub infer_p50_us: Option<f64>,
    /// 99 % quantile, us.
    pub infer_p99_us: Option<f64>,
    /// Maximum, us.
    pub infer_max_us: Option<f64>,
    /// Allocations by Rust code per call; those by C and C++ are not counted.
    pub allocations_per_call: Option<f64>,
    /// Reason for missing figures.
    pub note: Option<String>,
}

/// All rows.
#[derive(Clone, Debug, Serialize)]
pub struct PolicyResults {
    /// One row per back end.
    pub rows: Vec<Row>,
    /// The net's layers.
    pub net: &'static str,
    /// Measured inferences per back end.
    pub runs: u32,
    /// The machine.
    pub conditions: Machine,
}

/// A random network of the experiment's size.
///
/// # Panics
/// Never: the shapes are constants that fit.
pub fn net(hidden: usize, seed: u64) -> Mlp {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut layer = |inputs: usize, outputs: usize, activation| {
        let mut next = || {
            let unit = (dice.next_u64() >> 40) as f32 / (1_u64 << 23) as f32 - 1.0;
            unit / (inputs as f32).sqrt()
        };
        Layer {
            weights: (0..inputs * outputs).map(|_| next()).collect(),
            bias: (0..outputs).map(|_| next()).collect(),
            inputs,
            outputs,
            activation,
        }
    };
    let layers = vec![
        layer(FEATURES, hidden, Activation::Relu),
        layer(hidden, hidden, Activation::Relu),
        layer(hidden, policy::ACTIONS, Activation::Tanh),
    ];
    Mlp::new(layers).expect("layers that follow on each other")
}

struct Meter {
    gauges: Gauges,
    runs: u32,
    features: Vec<f32>,
}

impl Meter {
    fn row(&self, backend: &'static str, mut infer: impl FnMut(&[f32])) -> Row {
        let mut times_ns = histogram();
        for _ in 0..WARM_UP {
            infer(std::hint::black_box(&self.features));
        }
        let before = self.gauges.allocations();
        for _ in 0..self.runs {
            let begun = self.gauges.now();
            infer(std::hint::black_box(&self.features));
            times_ns.saturating_record(self.gauges.now().since_ns(begun));
        }
        let allocated = self.gauges.allocations() - before;
        let us = |ns: u64| Some(ns as f64 / 1e3);
        Row {
            backend,
            infer_p50_us: us(times_ns.value_at_quantile(0.5)),
            infer_p99_us: us(times_ns.value_at_quantile(0.99)),
            infer_max_us: us(times_ns.max()),
            allocations_per_call: Some(allocated as f64 / f64::from(self.runs)),
            note: None,
        }
    }
}

fn histogram() -> Histogram<u64> {
    // These constant bounds are valid.
    Histogram::new_with_bounds(1, 10_000_000_000, 3).expect("valid bounds")
}

fn absent(backend: &'static str, note: String) -> Row {
    Row {
        backend,
        infer_p50_us: None,
        infer_p99_us: None,
        infer_max_us: None,
        allocations_per_call: None,
        note: Some(note),
    }
}

/// An untrained net of the learner's for how bodies move, too, with 512 neurons in each of the
/// hidden layers and so many filters in each of the convolutions.
fn trained(filters: usize) -> anyhow::Result<Mlp> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let size = Size {
        inputs: INPUTS_WITH_MOTION,
        hidden: 512,
        filters,
        batch: 1,
    };
    let rate = Rate {
        start: 0.0,
        decay_steps: 0,
    };
    let actor = actor(size, rate, &mut random);
    Ok(export::mlp(&actor.network)?)
}

/// The net behind the compression that the learner's policies have.
fn compressed(mlp: &Mlp) -> Mlp {
    let layers = mlp.layers().to_vec();
    Mlp::compressed(learner::features::COMPRESSION, layers).expect("the layers of a net")
}

fn native(backend: &'static str, mlp: &Mlp, meter: &Meter) -> Row {
    let mut mlp = mlp.clone();
    meter.row(backend, |features| {
        std::hint::black_box(mlp.infer(features));
    })
}

/// The matrix products alone, with fused multiply-add where the processor has it: no bias,
/// no activation, no checks, and weights stored in reading order. A lower limit.
fn bare(mlp: &Mlp, meter: &Meter) -> Row {
    let arch = pulp::Arch::new();
    let layers: Vec<_> = mlp.layers().iter().map(Blocks::new).collect();
    let (mut x, mut y) = (vec![0.5_f32; 512], vec![0.0_f32; 512]);
    meter.row("bare matrix-vector product", |features| {
        x[..FEATURES].copy_from_slice(features);
        for layer in &layers {
            arch.dispatch(Bare {
                layer,
                x: &x,
                y: &mut y,
            });
            std::mem::swap(&mut x, &mut y);
        }
        std::hint::black_box(&x);
    })
}

struct Blocks {
    blocks: Vec<[f32; BLOCK]>,
    inputs: usize,
}

impl Blocks {
    fn new(layer: &Layer) -> Blocks {
        let count = layer.outputs.div_ceil(BLOCK);
        let mut blocks = vec![[0.0; BLOCK]; count * layer.inputs];
        for (k, weight) in layer.weights.iter().enumerate() {
            let (output, input) = (k / layer.inputs, k % layer.inputs);
            blocks[output / BLOCK * layer.inputs + input][output % BLOCK] = *weight;
        }
        Blocks {
            blocks,
            inputs: layer.inputs,
        }
    }
}

struct Bare<'a> {
    layer: &'a Blocks,
    x: &'a [f32],
    y: &'a mut [f32],
}

impl pulp::NullaryFnOnce for Bare<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let blocks = self.layer.blocks.chunks_exact(self.layer.inputs);
        for (block, y) in blocks.zip(self.y.chunks_exact_mut(BLOCK)) {
            let mut sums = [0.0_f32; BLOCK];
            for (weights, &x) in block.iter().zip(self.x) {
                for (sum, weight) in sums.iter_mut().zip(weights) {
                    *sum = weight.mul_add(x, *sum);
                }
            }
            y.copy_from_slice(&sums);
        }
    }
}

/// ONNX Runtime, called directly and, as in the tick, through its own thread.
fn onnx_runtime(
    arguments: &BenchPolicy,
    bytes: &[u8],
    mlp: &Mlp,
    meter: &Meter,
) -> anyhow::Result<Vec<Row>> {
    const NAMES: [&str; 2] = [
        "ONNX Runtime, called straight",
        "ONNX Runtime, as in the tick",
    ];
    let configured = arguments.onnxruntime.as_deref();
    let configured = configured.map_or(String::new(), |path| path.display().to_string());
    let Ok(library) = library(&configured) else {
        let note = "not installed: ./vlaps setup onnxruntime";
        return Ok(NAMES.map(|name| absent(name, note.into())).into());
    };
    let file = decode(bytes)?;
    let (Net::Mlp { names, .. } | Net::Graph(names)) = &file.net;
    let mut session = OrtSession::new(&library, bytes, names)?;
    let (theirs, ours) = (
        session.infer(&meter.features),
        mlp.clone().infer(&meter.features),
    );
    if (0..2).any(|k| (theirs[k] - ours[k]).abs() > policy::TOLERANCE) {
        bail!("ONNX Runtime answers {theirs:?}, the native runtime {ours:?}");
    }
    let straight = meter.row(NAMES[0], |features| {
        std::hint::black_box(session.infer(features));
    });
    let mut threaded = OrtPolicy::new(session, (1, &file.sha256), PATIENCE, meter.gauges.clock())?;
    let in_tick = meter.row(NAMES[1], |features| {
        std::hint::black_box(threaded.infer(features));
    });
    Ok(vec![straight, in_tick])
}

/// The same network in PyTorch: one thread, batch of one.
const SCRIPT: &str = r#"
import sys, time
import torch
torch.set_num_threads(1)
warm_up, runs = int(sys.argv[1]), int(sys.argv[2])
net = torch.nn.Sequential(torch.nn.Linear(259, 256), torch.nn.ReLU(), torch.nn.Linear(256, 256),
                          torch.nn.ReLU(), torch.nn.Linear(256, 2), torch.nn.Tanh()).eval()
features = torch.rand(1, 259)
times = []
with torch.inference_mode():
    for k in range(warm_up + runs):
        begun = time.perf_counter_ns()
        net(features)
        if k >= warm_up:
            times.append(time.perf_counter_ns() - begun)
print("times", *times)
"#;

fn pytorch(arguments: &BenchPolicy, meter: &Meter) -> Row {
    const NAME: &str = "PyTorch, one thread";
    let python = arguments
        .python
        .clone()
        .unwrap_or_else(|| PathBuf::from("python3"));
    let output = Command::new(&python)
        .args(["-c", SCRIPT, &WARM_UP.to_string(), &meter.runs.to_string()])
        .output();
    let Ok(output) = output.context("python") else {
        return absent(NAME, format!("{} does not start", python.display()));
    };
    let text = String::from_utf8_lossy(&output.stdout);
    let times = text.lines().find_map(|line| line.strip_prefix("times "));
    let Some(times) = times else {
        return absent(NAME, format!("not installed in {}", python.display()));
    };
    let mut times_ns = histogram();
    for time in times.split(' ').filter_map(|time| time.parse().ok()) {
        times_ns.saturating_record(time);
    }
    let us = |ns: u64| Some(ns as f64 / 1e3);
    Row {
        backend: NAME,
        infer_p50_us: us(times_ns.value_at_quantile(0.5)),
        infer_p99_us: us(times_ns.value_at_quantile(0.99)),
        infer_max_us: us(times_ns.max()),
        allocations_per_call: None,
        note: None,
    }
}

fn print(results: &PolicyResults) {
    let mut table = table(&["", "p50 us", "p99 us", "max us", "allocations a call"]);
    for row in &results.rows {
        let number = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.1}"));
        let name = match &row.note {
            Some(note) => format!("{} ({note})", row.backend),
            None => row.backend.into(),
        };
        table.add_row([
            name,
            number(row.infer_p50_us),
            number(row.infer_p99_us),
            number(row.infer_max_us),
            number(row.allocations_per_call),
        ]);
    }
    say(table);
    say(format_args!(
        "{}; {} answers each, one thread, no real-time priority, {}",
        results.net, results.runs, results.conditions
    ));
}
