//! Command line of `./vlaps train`.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::{Args, ValueEnum};
use serde::{Deserialize, Serialize};
use shm_config::config::{Algorithm, Simulator};
use shm_config::run::RunName;
use supervisor::cli::parsers::whole;

use stack::Clock;
use supervisor::commands::link::address;
use supervisor::commands::up::arguments::SimulatorAlone;
use supervisor::subcommand::{Configuration, Output, Subcommand};

use super::experiment::folder;
use super::{shards, train};
use crate::shard::Shard;

/// Train a policy while the process set drives: the paper's experiment.
#[derive(Debug, Args)]
#[command(
    after_help = "The process set drives in lockstep on seeds 100 to 149. After every 200 steps the \
        learner updates the policy; it is adopted at the next tick and evaluated on seeds 1000 to \
        1049 without intervention (Sec. 5). The same seed gives the same policies. Ctrl-C stops \
        (exit code 1), --resume continues with the options of the beginning unless they are \
        given again.\n\n\
        --shard I/N trains the I-th of N parts of the seeds, on any machine. The same command \
        continues after Ctrl-C or a kill; a training that was interrupted begins again, because its \
        policy would be another one. --report merges the parts in --out and says which are missing \
        (exit code 1).\n\n\
        With --actors or --actors-at, actors drive whole episodes in place of the process set, up to \
        64 on this machine, and --resume begins an interrupted block again. Their steps are learnt in \
        the same order for any number of actors.\n\n\
        Algorithms: pvp (the paper's), ppl, hg-dagger, dagger, bc; results/learning.md \
        compares them.\n\n\
        Examples:\n  \
        ./vlaps train --algorithm dagger --steps 10000\n  \
        ./vlaps train --algorithm pvp --seed 0 --seeds 5 --out runs/pvp\n  \
        ./vlaps train --out runs/pvp --resume\n  \
        ./vlaps train --algorithm ppl --actors 4 --set learner.block_steps=2000 --out runs/fast\n  \
        ./vlaps train --out runs/pvp --resume --held-back\n  \
        ./vlaps train --out runs/pvp --report\n  \
        ./vlaps train --algorithm ppl --seeds 8 --shard 3/8 --out runs/ppl\n  \
        ./vlaps up --policy runs/train-dagger/policy.onnx --gate policy"
)]
pub struct Train {
    /// Algorithm: pvp, ppl, bc, hg-dagger or dagger; default: pvp.
    #[arg(long, value_name = "HOW", value_parser = algorithm)]
    pub algorithm: Option<Algorithm>,
    /// Number of training steps; default: 50000.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=100_000_000))]
    pub steps: Option<u64>,
    /// Number of evaluation episodes after every block; default: 50.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=100_000))]
    pub eval_episodes: Option<u64>,
    /// Number of evaluation episodes of the last policy, 0 for none; default: 1000.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=1_000_000))]
    pub final_episodes: Option<u64>,
    /// Seed of networks, replay and the order of episodes; default: 0.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=1_000_000_000))]
    pub seed: Option<u64>,
    /// Number of trainings, with consecutive seeds; default: 1.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u32>(1..=1000))]
    pub seeds: Option<u32>,
    /// Expert to learn from; default: mpc.
    #[arg(long, value_name = "DRIVER")]
    pub expert: Option<ExpertChoice>,
    /// World to train in; default: sim.
    #[arg(long, value_name = "WORLD", value_parser = SimulatorAlone)]
    pub world: Option<Simulator>,
    /// Train with N actor processes on this machine, whose worlds drive side by side, in place of
    /// one process set; their number changes no policy.
    #[arg(long, value_name = "N", allow_negative_numbers = true, conflicts_with = "shard",
          value_parser = whole::<u32>(0..=64))]
    pub actors: Option<u32>,
    /// Listen here for ./vlaps actor on other machines, with no actor on this one unless --actors
    /// says so; needs ./vlaps setup link here.
    #[arg(long, value_name = "HOST:PORT", value_parser = address, conflicts_with = "shard")]
    pub actors_at: Option<String>,
    /// The run whose invitations these actors have, as of ./vlaps link invite --run;
    /// default: default.
    #[arg(long, value_name = "NAME", requires = "actors_at")]
    pub actors_run: Option<RunName>,
    /// Folder of the experiment; default: runs/train-HOW.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Continue the experiment in the folder.
    #[arg(long)]
    pub resume: bool,
    /// Also evaluate the last policies on the held-back seeds 50000 and up, which no setting
    /// was chosen on; with --resume after a training is complete.
    #[arg(long)]
    pub held_back: bool,
    /// Train part I of N of the seeds, such as 3/8, in the folder of --out, which may be shared
    /// by machines or be copied together.
    #[arg(long, value_name = "I/N", requires = "out", conflicts_with_all = ["resume", "held_back", "json"])]
    pub shard: Option<Shard>,
    /// Neither train nor evaluate: draw and print the results in the folder.
    #[arg(long, conflicts_with_all = ["shard", "resume", "steps", "seed", "seeds", "eval_episodes",
          "final_episodes", "held_back", "expert", "world", "actors", "actors_at", "config", "vehicle", "overrides"])]
    pub report: bool,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
    /// Also write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for Train {
    fn outputs(&self) -> Vec<Output> {
        let folder = match &self.out {
            Some(folder) if self.shard.is_some() => Output::Folder("--out", Some(folder.clone())),
            Some(folder) => Output::FolderOfParent("--out", Some(folder.clone())),
            None => Output::Folder("--out", Some(folder(self))),
        };
        vec![folder, Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        match (self.report, self.shard) {
            (true, _) => return shards::report(self, &folder(self)),
            (false, Some(shard)) => shards::train(self, (shard, &folder(self)), clock)?,
            (false, None) => train(self, clock)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

/// The experts to learn from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum ExpertChoice {
    /// The paper's RRT* with PD controller.
    RrtStar,
    /// RRT* that reuses its previous path, with PD controller.
    Informed,
    /// RRT* over curves that the car can drive, with PD controller.
    Kinodynamic,
    /// Model-predictive control.
    Mpc,
}

impl ExpertChoice {
    /// The value of `planner.method`.
    pub fn key(self) -> &'static str {
        match self {
            ExpertChoice::RrtStar => "rrt_star",
            ExpertChoice::Informed => "informed",
            ExpertChoice::Kinodynamic => "kinodynamic",
            ExpertChoice::Mpc => "mpc",
        }
    }
}

pub(crate) fn algorithm(text: &str) -> Result<Algorithm, String> {
    let all = [
        Algorithm::Pvp,
        Algorithm::Ppl,
        Algorithm::Bc,
        Algorithm::HgDagger,
        Algorithm::Dagger,
    ];
    let found = all.into_iter().find(|algorithm| algorithm.word() == text);
    let words = all.map(Algorithm::word).join(", ");
    found.ok_or_else(|| format!("must be one of {words}"))
}
