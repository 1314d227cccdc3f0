//! The command line.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use shm_config::config::planner::Method;
use shm_config::config::{GateMode, Simulator};
use shm_config::run::RunName;

use crate::cli::parsers::{Name, whole};

/// Drives a set of real-time processes that drive a car.
#[derive(Debug, Parser)]
#[command(
    name = "vlaps",
    bin_name = "./vlaps",
    version,
    arg_required_else_help = true,
    after_help = "Examples:\n  \
        ./vlaps up --episodes 1 --seed 3          drive one episode in real time\n  \
        ./vlaps up --lockstep --episodes 5        as fast as the processes answer\n  \
        ./vlaps status                            who is alive, on time, in charge\n  \
        ./vlaps swap policy.onnx                  new weights for a running set\n  \
        ./vlaps eval --driver expert              1000 episodes: success, contacts, completion\n  \
        ./vlaps draw episode --seed 1000          an episode from above\n  \
        ./vlaps doctor                            what this machine grants"
)]
pub struct Arguments {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start the process set and drive.
    Up(Up),
    /// Stop a running set; the car is braked to a stand first.
    Down(Down),
    /// Show who is alive, on time and in charge.
    Status(Status),
    /// Offer policy weights to a running set; exit code 0 when they are adopted.
    Swap(Swap),
    /// Show what this machine grants, and how to grant what is missing.
    Doctor,
    /// Remove what killed runs left behind; living runs are not touched.
    Clean(Clean),
    /// Install what an optional part needs.
    Setup(Setup),
    /// Print the configuration with its defaults, or check a file.
    Config(Keys),
    /// Drive many episodes and print success, contacts and completion.
    #[command(disable_help_flag = true)]
    Eval(HandedOver),
    /// Measure, and compare with other systems: parity, sim, planner, mpc, policy, learner,
    /// swap, judge, latency, ipc, faults, soak, sweep.
    #[command(disable_help_flag = true)]
    Bench(HandedOver),
    /// Draw a map, an episode or a plan from above, as SVG.
    #[command(disable_help_flag = true)]
    Draw(HandedOver),
    /// Train a policy while the process set drives: the paper's experiment.
    #[command(disable_help_flag = true)]
    Train(HandedOver),
    /// Audit what a judge was asked and said, or ask another model the same.
    #[command(disable_help_flag = true)]
    Judge(HandedOver),
    /// Serve a stand-in for a vision-language model: it judges pixels, and is no model.
    #[command(disable_help_flag = true)]
    JudgeServer(HandedOver),
}

/// What another program of the build does: it reads the words itself.
#[derive(Debug, Args)]
pub struct HandedOver {
    /// Its options; --help shows them.
    #[arg(
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "OPTIONS"
    )]
    pub words: Vec<OsString>,
}

/// Start the process set and drive.
#[derive(Debug, Args)]
#[command(
    after_help = "Without --episodes and --duration it drives until it is stopped: \
        Ctrl-C brakes the car to a stand, a second Ctrl-C kills (exit code 130: 128 and the \
        signal's number). When its output is piped and the reader goes away, the car is braked \
        to a stand, too, and the exit code is 1.\n\n\
        With --gate human the keys of this terminal drive: Space takes over and gives back, \
        arrows or WASD steer and pedal meanwhile, Esc or q gives back. --keys FILE reads them \
        from lines TIME_S KEY instead, such as `2.5 space`: seconds from the run's first tick, \
        and one of space, left, right, up, down, w, a, s, d, esc, q, in capitals or not. A key counts as held for \
        0.5 s, each repetition for 0.15 s more.\n\n\
        Examples:\n  \
        ./vlaps up --episodes 1 --seed 3\n  \
        ./vlaps up --gate human --policy policy.onnx\n  \
        ./vlaps up --lockstep --episodes 5 --seed 3 --json a.json\n  \
        ./vlaps up --duration 60 --late-ticks\n  \
        ./vlaps up --rate 20 --run second --set world.traffic_density=0.1"
)]
pub struct Up {
    /// Seed of the first episode; each further one adds one.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// Episodes to drive; 0 for no end.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u32>(0..=u64::from(u32::MAX)))]
    pub episodes: Option<u32>,
    /// Seconds to drive on the run's clock; 0 for no end.
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    pub duration: Option<f64>,
    /// Run as fast as the processes answer; the same seed gives the same commands.
    #[arg(long)]
    pub lockstep: bool,
    /// Who computes the world; metadrive needs `./vlaps setup metadrive` once.
    #[arg(long, value_name = "WHICH")]
    pub world: Option<WorldChoice>,
    /// How the expert plans; the paper's RRT* without it.
    #[arg(long, value_name = "HOW")]
    pub driver: Option<DriverChoice>,
    /// Who decides who drives.
    #[arg(long, value_name = "WHO")]
    pub gate: Option<GateChoice>,
    /// Keys of --gate human from this file of at most 1 MiB in place of the terminal.
    #[arg(long, value_name = "FILE")]
    pub keys: Option<PathBuf>,
    /// Policy to begin with; it drives where --gate lets it, after its probation.
    #[arg(long, value_name = "FILE.onnx")]
    pub policy: Option<PathBuf>,
    /// Ticks per second.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// Configuration file; vlaps.toml of the current folder is read when present.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Name of the run; sets of different names do not see each other.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
    /// Write the summary to this file, too; a pipe needs its reader from the start.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Override any key of the configuration, such as gate.period_s=5; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Ask for no real-time priority, cores or locked memory.
    #[arg(long)]
    pub no_realtime: bool,
    /// Show the ticks that were latest at the end, with the part that took longest.
    #[arg(long)]
    pub late_ticks: bool,
    /// End with the process of this id, which started this one.
    #[arg(long, value_name = "PID", hide = true)]
    pub parent: Option<u32>,
}

/// How the expert plans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum DriverChoice {
    /// The paper's RRT* and PD.
    RrtStar,
    /// RRT* that remembers its last path, and PD.
    Informed,
    /// RRT* over curves the car can drive, and PD.
    Kinodynamic,
    /// Model-predictive control.
    Mpc,
}

impl From<DriverChoice> for Method {
    fn from(choice: DriverChoice) -> Self {
        match choice {
            DriverChoice::RrtStar => Self::RrtStar,
            DriverChoice::Informed => Self::Informed,
            DriverChoice::Kinodynamic => Self::Kinodynamic,
            DriverChoice::Mpc => Self::Mpc,
        }
    }
}

/// Who decides who drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GateChoice {
    /// The gate process compares both rollouts by exact geometry.
    Rules,
    /// The gate process asks a vision-language model (section vlm); never pauses the world.
    Vlm,
    /// As the paper did it: asks every 10 s, and the world waits. Implies --lockstep.
    Paper,
    /// Several judges and a quorum (gate.committee, gate.quorum).
    Committee,
    /// The answers of a recorded run (gate.recording).
    Replay,
    /// Always the expert; no gate process.
    Expert,
    /// Always the policy, if one is loaded; no gate process.
    Policy,
    /// The policy, until a person at the keys takes over; no gate process.
    Human,
}

impl From<GateChoice> for GateMode {
    fn from(choice: GateChoice) -> Self {
        match choice {
            GateChoice::Rules => Self::Rules,
            GateChoice::Vlm => Self::Vlm,
            GateChoice::Paper => Self::Paper,
            GateChoice::Committee => Self::Committee,
            GateChoice::Replay => Self::Replay,
            GateChoice::Expert => Self::Expert,
            GateChoice::Policy => Self::Policy,
            GateChoice::Human => Self::Human,
        }
    }
}

/// Who computes the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum WorldChoice {
    /// The built-in world.
    Sim,
    /// The real MetaDrive.
    Metadrive,
}

impl From<WorldChoice> for Simulator {
    fn from(choice: WorldChoice) -> Self {
        match choice {
            WorldChoice::Sim => Self::BuiltIn,
            WorldChoice::Metadrive => Self::MetaDrive,
        }
    }
}

/// Install what an optional part needs.
#[derive(Debug, Args)]
#[command(
    after_help = "Does only what is missing, so it may be repeated; with another --checkout, or \
        without, it replaces the MetaDrive that is there. It installs into target/metadrive; \
        the environment variable VLAPS_METADRIVE names another folder, for setup, up, eval and \
        bench alike.\n\n\
        Examples:\n  \
        ./vlaps setup metadrive\n  \
        ./vlaps setup onnxruntime\n  \
        VLAPS_METADRIVE=$HOME/md-c29 ./vlaps setup metadrive --checkout ../metadrive"
)]
pub struct Setup {
    /// Which part.
    pub part: Part,
    /// Install MetaDrive from this checkout of its repository, not its release.
    ///
    /// The built-in world mirrors commit c29cc37 of metadriverse/metadrive. The
    /// release on the registry, 0.4.3, has older lanes at in- and out-ramps:
    /// figures that are compared need the commit. The checkout is only read; all
    /// other packages stay as pinned.
    #[arg(long, value_name = "DIR")]
    pub checkout: Option<PathBuf>,
    /// The Python to install for; without it, python3.11 or python3.
    #[arg(long, value_name = "FILE")]
    pub python: Option<PathBuf>,
}

/// A part that needs more than a build.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// The real MetaDrive as world: a Python environment of about 1 GB.
    Metadrive,
    /// ONNX Runtime, for policies that are no chain of layers: 60 MB.
    Onnxruntime,
}

/// Stop a running set.
#[derive(Debug, Args)]
#[command(
    after_help = "Without --run it stops the one set of this folder: a set whose run.folder \
        (runs/NAME where it was started) lies in the current folder or below it, and which no \
        training or evaluation drives. A set of another folder is never stopped unless it is \
        named.\n\n\
        Exit code 0: it is stopped, or the named run was not running, or nothing runs \
        (status and swap exit 1 then). 1: it does not end, or what holds the run's place is no supervisor of it. 2: no run is named, \
        and none of this folder runs though others do, or several do.\n\n\
        Examples:\n  \
        ./vlaps down\n  \
        ./vlaps down --run second"
)]
pub struct Down {
    /// Name of the run; without it, the one set of this folder.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
}

/// Offer policy weights to a running set; exit code 0 when they are adopted.
#[derive(Debug, Args)]
#[command(
    after_help = "The set checks size, hash, format, observation layout, operators, shapes, \
        weights and probes, warms the net, and adopts it between two ticks. It then proposes in \
        shadow for policy.probation_ticks before it may drive.\n\n\
        Without --run it is offered to the one set of this folder: a set whose run.folder \
        (runs/NAME where it was started) lies in the current folder or below it, and which no \
        training or evaluation drives.\n\n\
        Exit code 1: refused, or nothing runs; 2: the file cannot be read, or no run is named \
        and none of this folder runs though others do, or several do.\n\n\
        Examples:\n  \
        ./vlaps swap policy.onnx\n  \
        ./vlaps swap policy.onnx --run second --wait-ready"
)]
pub struct Swap {
    /// The policy file: ONNX, 259 features in, 2 actions out, at most 8 MB.
    pub file: PathBuf,
    /// Name of the run; without it, the one set of this folder.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
    /// Wait for the end of the probation, too; exit code 1 when it is not passed.
    #[arg(long)]
    pub wait_ready: bool,
}

/// Show who is alive, on time and in charge.
#[derive(Debug, Args)]
#[command(after_help = "Exit code 1 says that none runs.\n\n\
        Examples:\n  ./vlaps status\n  ./vlaps status --run second --json status.json")]
pub struct Status {
    /// Name of the run; without it, all of them.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
    /// Write what is shown to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Remove what killed runs left behind.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  ./vlaps clean")]
pub struct Clean {
    /// Name of the run; without it, all of them.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
}

/// Print the configuration with its defaults, or check a file.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
        ./vlaps config > vlaps.toml       a file to change\n  \
        ./vlaps config --check vlaps.toml")]
pub struct Keys {
    /// Check this file instead; exit code 2 when it is wrong.
    #[arg(long, value_name = "FILE")]
    pub check: Option<PathBuf>,
}
