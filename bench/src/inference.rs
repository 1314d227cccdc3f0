//! `bench policy`: how long the net of a policy takes to answer, by back end.

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
use policy::{Activation, Layer, Mlp, Net, Provenance, decode, encode};
use serde::Serialize;
use shm_config::message::FEATURES;

use lab::report::{Machine, table};
use stack::Clock;
use supervisor::subcommand::{say, write_json_option};

/// Measure how long the policy's net takes to answer, by back end.
#[derive(Debug, Args)]
#[command(
    after_help = "Rows: the bare product of the same size (the limit), the native runtime, ONNX \
        Runtime (after ./vlaps setup onnxruntime), and PyTorch where the Python has it.\n\n\
        Examples:\n  \
        ./vlaps bench policy\n  \
        ./vlaps bench policy --python torch/bin/python --json policy.json"
)]
pub struct BenchPolicy {
    /// Answers to measure of each.
    #[arg(long, value_name = "N", default_value_t = 20_000,
          allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=10_000_000))]
    pub runs: u32,
    /// libonnxruntime.so or its folder, if not that of ./vlaps setup onnxruntime.
    #[arg(long, value_name = "FILE")]
    pub onnxruntime: Option<PathBuf>,
    /// A Python with PyTorch; without it, python3.
    #[arg(long, value_name = "FILE")]
    pub python: Option<PathBuf>,
    /// Write the rows to this file, too.
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
        let mut rows = vec![bare(&mlp, &meter), native(&mlp, &meter)];
        rows.extend(onnx_runtime(self, &bytes, &mlp, &meter)?);
        rows.push(pytorch(self, &meter));
        let inferred = Inferred {
            rows,
            net: "259-256-256-2, ReLU, tanh at the end",
            runs: self.runs,
            conditions,
        };
        print(&inferred);
        write_json_option(&self.json, &inferred)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Width of the two hidden layers: that of the experiment's actor.
const HIDDEN: usize = 256;
/// Runs before those that are measured.
const WARM_UP: u32 = 1000;
/// Outputs whose sums the bare product keeps in registers.
const BLOCK: usize = 64;
/// How long ONNX Runtime in its own thread is waited for: longer than any tick.
const PATIENCE: Duration = Duration::from_millis(100);

/// What one back end takes.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Which.
    pub backend: &'static str,
    /// Median of an answer, us.
    pub infer_p50_us: Option<f64>,
    /// 99 % of the answers took no longer, us.
    pub infer_p99_us: Option<f64>,
    /// The longest, us.
    pub infer_max_us: Option<f64>,
    /// Allocations of Rust in a call; what C and C++ allocate is not seen.
    pub allocations_per_call: Option<f64>,
    /// Why there are no figures.
    pub note: Option<String>,
}

/// All rows of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Inferred {
    /// A row for each back end.
    pub rows: Vec<Row>,
    /// The net's layers.
    pub net: &'static str,
    /// Answers measured of each.
    pub runs: u32,
    /// Where.
    pub conditions: Machine,
}

/// A net of the experiment's size, out of a seed.
///
/// # Panics
/// Never: the shapes are constants that fit.
pub fn net(hidden: usize, seed: u64) -> Mlp {
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::{Rng, SeedableRng};
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
    // Constants that the library accepts.
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

fn native(mlp: &Mlp, meter: &Meter) -> Row {
    let mut mlp = mlp.clone();
    meter.row("native, in the tick", |features| {
        std::hint::black_box(mlp.infer(features));
    })
}

/// The products alone, fused where the processor can: no bias, no activation, no
/// checks, and the weights in the order they are read in. The limit.
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

/// ONNX Runtime called straight, and as the tick would: over a thread of its own.
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

/// The same net in PyTorch, one thread, on one input.
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

fn print(inferred: &Inferred) {
    let mut table = table(&["", "p50 us", "p99 us", "max us", "allocations a call"]);
    for row in &inferred.rows {
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
        inferred.net, inferred.runs, inferred.conditions
    ));
}
