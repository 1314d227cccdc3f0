//! The command line.

mod draw;

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use serde::{Deserialize, Serialize};
use supervisor::cli::parsers::whole;

use crate::faults::BenchFaults;
use crate::ipc::{BenchIpc, IpcEcho};
use crate::judging::BenchJudge;
use crate::latency::BenchLatency;
use crate::seat::DriverKind;
use crate::soak::BenchSoak;
use crate::sweep::BenchSweep;
use crate::train::arguments::Train;
pub use draw::{Draw, DrawEpisode, DrawFrame, DrawMap, DrawPlan};

/// Evaluates drivers, compares with other systems, draws pictures.
#[derive(Debug, Parser)]
#[command(
    name = "vlaps",
    bin_name = "./vlaps",
    version,
    arg_required_else_help = true
)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Drive many episodes and print success, contacts and completion.
    Eval(Eval),
    /// Measure, and compare with other systems.
    #[command(subcommand, arg_required_else_help = true)]
    Bench(Bench),
    /// Draw a map, an episode or a plan from above, or what the world's camera sees.
    #[command(subcommand, arg_required_else_help = true)]
    Draw(Draw),
    /// Train a policy while the process set drives: the paper's experiment.
    Train(Train),
}

/// Drive many episodes and print success, contacts and completion.
#[derive(Debug, Args)]
#[command(
    after_help = "Every episode depends on its seed alone: the figures are the same on any \
        number of threads. The expert is the very planner and controller of \
        `./vlaps up --lockstep --gate expert`, and gives the same commands; rrt-star, \
        informed, kinodynamic and mpc are the expert with that planner.method.\n\n\
        Examples:\n  \
        ./vlaps eval --driver expert --episodes 1000\n  \
        ./vlaps eval --driver mpc --episodes 200\n  \
        ./vlaps eval --driver policy.onnx --episodes 200\n  \
        ./vlaps eval --driver idm --first-seed 100 --episodes 50 --json idm.json\n  \
        ./vlaps eval --driver expert --world metadrive --episodes 50"
)]
pub struct Eval {
    /// Who drives: expert, rrt-star, informed, kinodynamic, mpc, lane, idm, or
    /// the policy of a file, FILE.onnx, alone.
    #[arg(long, value_name = "WHO", default_value = "expert")]
    pub driver: DriverKind,
    /// How many episodes.
    #[arg(long, value_name = "N", default_value_t = 1000,
          allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=1_000_000))]
    pub episodes: u64,
    /// Seed of the first episode; each further one adds one.
    #[arg(long, value_name = "N", default_value_t = 1000, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// In which world.
    #[arg(long, value_name = "WORLD", default_value = "sim")]
    pub world: WorldChoice,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
    /// Threads; without it, as many as there are cores. Each has a MetaDrive of
    /// its own.
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    pub threads: Option<NonZeroUsize>,
    /// Draw the failures into this folder, at most 50, as they go in the built-in
    /// world.
    #[arg(long, value_name = "DIR")]
    pub draw: Option<PathBuf>,
    /// Write the figures to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// The worlds that an evaluation can run in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum WorldChoice {
    /// The built-in world.
    Sim,
    /// The real MetaDrive; see `./vlaps setup metadrive`.
    Metadrive,
}

impl WorldChoice {
    /// As on the command line.
    pub fn word(self) -> &'static str {
        match self {
            WorldChoice::Sim => "sim",
            WorldChoice::Metadrive => "metadrive",
        }
    }

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            WorldChoice::Sim => "the built-in world",
            WorldChoice::Metadrive => "MetaDrive",
        }
    }
}

/// The configuration of a run.
#[derive(Debug, Args)]
pub struct Configuration {
    /// Configuration file; vlaps.toml of the current folder is read when present.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override any key of the configuration, such as world.blocks=5; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
}

/// What to measure.
#[derive(Debug, Subcommand)]
pub enum Bench {
    /// Compare the built-in world with recordings of MetaDrive.
    Parity(Parity),
    /// Measure how fast the built-in world is, beside MetaDrive.
    Sim(Sim),
    /// Measure how long plans take and how good they are, beside OMPL.
    Planner(BenchPlanner),
    /// Drive the model-predictive expert for long, disturbed: does it answer in time?
    Mpc(BenchMpc),
    /// Measure how long the policy's net takes to answer, by back end.
    Policy(BenchPolicy),
    /// Measure gradient steps per second, beside PyTorch.
    Learner(BenchLearner),
    /// Measure whether a running set notices that its weights are swapped.
    Swap(BenchSwap),
    /// Measure how often a judge is right where the simulator knows, over HTTP.
    Judge(BenchJudge),
    /// Measure how punctual a running set is, under load, beside the machine's own floor.
    Latency(BenchLatency),
    /// Measure how long a message takes from process to process, beside bare iceoryx2.
    Ipc(BenchIpc),
    /// The other end of ipc.
    #[command(hide = true)]
    IpcEcho(IpcEcho),
    /// Strike running sets with faults: is the car safe, does the set come back?
    Faults(BenchFaults),
    /// Drive a set in lockstep for millions of ticks: does any process grow?
    Soak(BenchSoak),
    /// Train under a judge that is wrong, silent or late: what does it cost?
    Sweep(BenchSweep),
}

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

/// Measure gradient steps per second, beside PyTorch.
#[derive(Debug, Args)]
#[command(
    after_help = "The update of pvp (twin critics, the actor every second time, Adam, targets \
        that follow) and that of the imitations, 2 x 256 neurons, on one thread and two; \
        PyTorch makes the same updates by turns where the Python has it.\n\n\
        Examples:\n  \
        ./vlaps bench learner\n  \
        ./vlaps bench learner --python torch/bin/python --json learner.json"
)]
pub struct BenchLearner {
    /// Seconds for each side of a row.
    #[arg(long, value_name = "S", default_value_t = 6.0, allow_negative_numbers = true,
          value_parser = seconds)]
    pub seconds: f64,
    /// A Python with PyTorch; without it, python3.
    #[arg(long, value_name = "FILE")]
    pub python: Option<PathBuf>,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Measure whether a running set notices that its weights are swapped.
#[derive(Debug, Args)]
#[command(
    after_help = "For each rate the whole set drives twice: without swaps, and with new weights \
        every second.\n\n\
        Examples:\n  \
        ./vlaps bench swap\n  \
        ./vlaps bench swap --seconds 300 --rate 10,100 --json swap.json"
)]
pub struct BenchSwap {
    /// Seconds for each row, 5 at least: nothing is swapped in the first and the
    /// last two.
    #[arg(long, value_name = "S", default_value_t = 30.0, allow_negative_numbers = true,
          value_parser = seconds)]
    pub seconds: f64,
    /// Ticks per second, one or more.
    #[arg(
        long,
        value_name = "HZ",
        allow_negative_numbers = true,
        value_delimiter = ',',
        default_value = "10,100"
    )]
    pub rate: Vec<f64>,
    /// Override any key of the configuration, such as planner.rate_hz=10; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Drive the model-predictive expert for long, disturbed: does it answer in time?
#[derive(Debug, Args)]
#[command(
    after_help = "A third of the time the road is free, a third a wall stands across it, a \
        third random commands are obeyed in place of the plan's.\n\n\
        Examples:\n  \
        ./vlaps bench mpc --json mpc.json\n  \
        ./vlaps bench mpc --ticks 2000 --set mpc.steps=16"
)]
pub struct BenchMpc {
    /// How many ticks.
    #[arg(long, value_name = "N", default_value_t = 100_000,
          allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=100_000_000))]
    pub ticks: u64,
    /// Seed of the first episode, and of the disturbances.
    #[arg(long, value_name = "N", default_value_t = 100, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
    /// Write the figures to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Measure how long plans take and how good they are, beside OMPL.
#[derive(Debug, Args)]
#[command(
    after_help = "Scenes are what the car saw in real episodes of the built-in world; \
        bench/scenes/README.md describes their file, so that others can be fed in. \
        RRT* always has the paper's numbers, the others those of the configuration. \
        --ompl builds bench/ompl with g++ and libompl-dev.\n\n\
        Examples:\n  \
        ./vlaps bench planner --json planner.json\n  \
        ./vlaps bench planner --ompl\n  \
        ./vlaps bench planner --record scenes.jsonl.gz --first-seed 100 --episodes 50\n  \
        ./vlaps bench planner --scenes scenes.jsonl.gz"
)]
pub struct BenchPlanner {
    /// The scenes to plan for; without it, the checked-in ones.
    #[arg(long, value_name = "FILE")]
    pub scenes: Option<PathBuf>,
    /// How often each scene is planned for.
    #[arg(long, value_name = "N", default_value_t = 10,
          allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=10_000))]
    pub rounds: u32,
    /// Compare the paper's planner with OMPL's RRTstar, too.
    #[arg(long)]
    pub ompl: bool,
    /// Measure nothing; drive episodes and record scenes into this file.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["scenes", "rounds", "ompl", "json"])]
    pub record: Option<PathBuf>,
    /// Seed of the first episode to record; each further one adds one.
    #[arg(long, value_name = "N", default_value_t = 100, requires = "record",
          allow_negative_numbers = true, value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// How many episodes to record.
    #[arg(long, value_name = "N", default_value_t = 50, requires = "record",
          allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=100_000))]
    pub episodes: u64,
    /// How many scenes to keep of them.
    #[arg(long, value_name = "N", default_value_t = 600, requires = "record",
          allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=1_000_000))]
    pub keep: u32,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Compare the built-in world with recordings of MetaDrive.
#[derive(Debug, Args)]
#[command(after_help = "Exit code 1 when a bar is missed.\n\n\
        Example:\n  ./vlaps bench parity --data recordings --json parity.json")]
pub struct Parity {
    /// Folder with golden_*.json.gz, rollouts/KIND/seedN.npz and dynamics.json.
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Measure how fast the built-in world is, beside MetaDrive.
#[derive(Debug, Args)]
#[command(
    after_help = "Everything is on: 240 beams, traffic, obstacles, resets, and a driver that \
        keeps its lane. MetaDrive runs on one core in the same run when \
        `./vlaps setup metadrive` has made its virtual environment.\n\n\
        Example:\n  ./vlaps bench sim --seconds 10 --json sim.json"
)]
pub struct Sim {
    /// Seconds for each row.
    #[arg(long, value_name = "S", default_value_t = 5.0, allow_negative_numbers = true,
          value_parser = seconds)]
    pub seconds: f64,
    /// Seed of the first episode.
    #[arg(long, value_name = "N", default_value_t = 1000, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// The virtual environment with MetaDrive, if not the one that
    /// `./vlaps setup metadrive` makes.
    #[arg(long, value_name = "DIR")]
    pub metadrive: Option<PathBuf>,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

pub(crate) fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "not a number".to_string())?;
    match (0.1..=3600.0).contains(&seconds) {
        true => Ok(seconds),
        false => Err("must be within 0.1 and 3600".into()),
    }
}
