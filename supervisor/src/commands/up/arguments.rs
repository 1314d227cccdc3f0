//! The arguments of `up`.

use std::ffi::OsStr;
use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::error::ErrorKind;
use clap::{Args, ValueEnum};
use shm_config::config::planner::Method;
use shm_config::config::{GateMode, Simulator};
use shm_config::run::RunName;
use shm_config::shortened;

use crate::cli::parsers::{Name, whole};
use crate::commands::link::address;
use crate::setup::foreign::{BUILT_IN, Foreign};

/// Start the process set and drive.
#[derive(Debug, Default, Args)]
#[command(
    after_help = "Without --episodes and --duration it drives until it is stopped: \
        Ctrl-C brakes the car to a stand, a second Ctrl-C kills (exit code 130: 128 and the \
        signal's number). When its output is a pipe and the reader ends, the car is also braked \
        to a stand, and the exit code is 1.\n\n\
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
        ./vlaps up --lockstep --vehicle vehicles/truck.toml --driver mpc --episodes 1\n  \
        ./vlaps up --rate 20 --run second --set world.traffic_density=0.1\n  \
        ./vlaps up --world ./my-robot --planner ./my-planner\n  \
        ./vlaps up --judge 0.0.0.0:7450 --learner 0.0.0.0:7451"
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
    /// The world: sim, the built-in one; metadrive, ir-sim, f1tenth or commonroad, which
    /// need `./vlaps setup` with this word once; or a program of yours, as a path with a '/'.
    #[arg(long, value_name = "WHICH|PROGRAM", value_parser = WorldOrProgram)]
    pub world: Option<UpWorld>,
    /// How the expert plans; the paper's RRT* without it.
    #[arg(long, value_name = "HOW")]
    pub driver: Option<DriverChoice>,
    /// A program of yours that plans, in place of the planner of the build.
    #[arg(long, value_name = "PROGRAM", conflicts_with = "driver")]
    pub planner: Option<PathBuf>,
    /// The gate, which decides between expert and policy.
    #[arg(long, value_name = "WHICH")]
    pub gate: Option<GateChoice>,
    /// In place of the gate process of the build: a program of yours that publishes advice, or
    /// a judge on another machine, for which the set waits at HOST:PORT of this one.
    #[arg(long, value_name = "PROGRAM|HOST:PORT")]
    pub judge: Option<PathBuf>,
    /// A learner on another machine, for which the set waits at HOST:PORT of this one.
    #[arg(long, value_name = "HOST:PORT", value_parser = address)]
    pub learner: Option<String>,
    /// Keys of --gate human from this file of at most 1 MiB in place of the terminal.
    #[arg(long, value_name = "FILE")]
    pub keys: Option<PathBuf>,
    /// Policy to begin with; it drives where --gate lets it, after its canary period.
    #[arg(long, value_name = "FILE.onnx")]
    pub policy: Option<PathBuf>,
    /// Ticks per second.
    #[arg(long, value_name = "HZ", allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// Configuration file; vlaps.toml of the current folder is read when present.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Vehicle file: the sections `vehicle` and `scanner` of the car, such as
    /// vehicles/truck.toml; its keys replace those of the configuration file.
    #[arg(long, value_name = "FILE")]
    pub vehicle: Option<PathBuf>,
    /// Name of the run; sets of different names do not see each other.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
    /// Write the summary to this file, too; a pipe needs its reader from the start.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Record every message to MCAP files in this folder, or in a new folder in
    /// run.folder/recording.
    #[arg(long, value_name = "DIR", num_args = 0..=1)]
    pub record: Option<Option<PathBuf>>,
    /// Record nothing.
    #[arg(long, conflicts_with = "record")]
    pub no_record: bool,
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

/// The gate, which decides between expert and policy.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum GateChoice {
    /// The gate process compares both rollouts by exact geometry.
    Rules,
    /// The gate process asks a vision-language model (section vlm); never pauses the world.
    Vlm,
    /// As in the paper: asks every 10 s, and the world waits. Implies --lockstep.
    Paper,
    /// A small net distilled from recorded answers (gate.distilled); a slow judge
    /// (gate.pass_to) answers what the net does not know.
    Distilled,
    /// The answers of a recorded run (gate.recording).
    Replay,
    /// Always the expert; no gate process.
    Expert,
    /// Always the policy, if one is loaded; no gate process.
    Policy,
    /// The policy, until a human driver takes over by the keys; no gate process.
    Human,
    /// The policy, and the expert in each tick in which their proposals differ by much
    /// (gate.takeover_steer, gate.takeover_pedal); no gate process.
    Takeover,
}

impl From<GateChoice> for GateMode {
    fn from(choice: GateChoice) -> Self {
        match choice {
            GateChoice::Rules => Self::Rules,
            GateChoice::Vlm => Self::Vlm,
            GateChoice::Paper => Self::Paper,
            GateChoice::Distilled => Self::Distilled,
            GateChoice::Replay => Self::Replay,
            GateChoice::Expert => Self::Expert,
            GateChoice::Policy => Self::Policy,
            GateChoice::Human => Self::Human,
            GateChoice::Takeover => Self::Takeover,
        }
    }
}

/// The world of an `up`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum UpWorld {
    /// A simulator.
    Simulator(Simulator),
    /// A user's program.
    Program(PathBuf),
}

/// The parser of [`UpWorld`]. A path has a '/', so no file hides a simulator.
#[derive(Debug, Clone, Copy)]
pub struct WorldOrProgram;

impl TypedValueParser for WorldOrProgram {
    type Value = UpWorld;

    fn parse_ref(
        &self,
        command: &clap::Command,
        option: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<UpWorld, clap::Error> {
        if value.as_encoded_bytes().contains(&b'/') {
            return Ok(UpWorld::Program(value.into()));
        }
        let word = PossibleValuesParser::new(worlds()).parse_ref(command, option, value)?;
        let named = |simulator: &&Simulator| simulator.word() == word;
        let simulator = Simulator::ALL.iter().find(named);
        Ok(UpWorld::Simulator(*simulator.expect("a word of the list")))
    }
}

/// The parser of [`Simulator`] for commands that drive no program of a user.
#[derive(Debug, Clone, Copy)]
pub struct SimulatorAlone;

impl TypedValueParser for SimulatorAlone {
    type Value = Simulator;

    fn parse_ref(
        &self,
        command: &clap::Command,
        option: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<Simulator, clap::Error> {
        match WorldOrProgram.parse_ref(command, option, value)? {
            UpWorld::Simulator(choice) => Ok(choice),
            UpWorld::Program(path) => {
                let path = shortened(&path.display().to_string());
                let message = format!(
                    "--world {path}: this command drives with the programs of the build; your \
                     program drives in ./vlaps up --world {path}\n"
                );
                Err(clap::Error::raw(ErrorKind::ValueValidation, message).with_cmd(command))
            }
        }
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(worlds()))
    }
}

/// Each simulator with what it is.
fn worlds() -> impl Iterator<Item = PossibleValue> {
    Simulator::ALL.iter().map(|&simulator| {
        let word = simulator.word();
        match Foreign::of(simulator) {
            None => PossibleValue::new(word).help(BUILT_IN),
            Some(foreign) => {
                let help = format!("{}; see `./vlaps setup {word}`", foreign.name);
                PossibleValue::new(word).help(help)
            }
        }
    })
}
