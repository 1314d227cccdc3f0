//! The list of commands. Each command's own arguments are in its file of [`crate::commands`].

use clap::{Parser, Subcommand};

use crate::commands::clean::Clean;
use crate::commands::cluster::Cluster;
use crate::commands::config::ConfigArguments;
use crate::commands::conform::Conform;
use crate::commands::delegate::Delegated;
use crate::commands::down::Down;
use crate::commands::link::{Join, Link};
use crate::commands::setup::Setup;
use crate::commands::status::Status;
use crate::commands::swap::Swap;
use crate::commands::up::arguments::Up;

/// Runs a set of real-time processes that drive a car.
#[derive(Debug, Parser)]
#[command(
    name = "vlaps",
    bin_name = "./vlaps",
    version,
    arg_required_else_help = true,
    after_help = "Examples:\n  \
        ./vlaps up --episodes 1 --seed 3          drive one episode in real time\n  \
        ./vlaps up --lockstep --episodes 5        as fast as the processes answer\n  \
        ./vlaps status                            which processes live and are on time; the driver\n  \
        ./vlaps view                              a page that shows what happens now\n  \
        ./vlaps swap policy.onnx                  new weights for a running set\n  \
        ./vlaps eval --driver expert              1000 episodes: success, contacts, completion\n  \
        ./vlaps draw episode --seed 1000          an episode from above\n  \
        ./vlaps doctor                            what this machine grants"
)]
pub struct Arguments {
    /// The command.
    #[command(subcommand)]
    pub command: Command,
}

/// A command.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start the process set and drive.
    Up(Box<Up>),
    /// Stop a running set; the car is braked to a stand first.
    Down(Down),
    /// Show which processes live, whether they are on time, and which driver drives.
    Status(Status),
    /// Offer policy weights to a running set; exit code 0 when they are adopted.
    Swap(Swap),
    /// Show what this machine grants, and how to grant what is missing.
    Doctor,
    /// Remove what killed runs left behind; living runs are not touched.
    Clean(Clean),
    /// Record a running set to files, as one reader more.
    #[command(disable_help_flag = true)]
    Record(Delegated),
    /// Install what an optional part needs.
    Setup(Setup),
    /// Print the configuration with its defaults, or check a file.
    Config(ConfigArguments),
    /// Test the promises of a world program: grid, age limits, brake, refusals, end.
    Conform(Conform),
    /// Drive many episodes and print success, contacts and completion.
    #[command(disable_help_flag = true)]
    Eval(Delegated),
    /// Measure: parity, sim, planner, mpc, tracker, policy, learner, actors, swap, judge, latency,
    /// ipc, faults, replay, scale, soak.
    #[command(disable_help_flag = true)]
    Bench(Delegated),
    /// Show a running set, or a recording, as a page for a browser.
    #[command(disable_help_flag = true)]
    View(Delegated),
    /// Draw a map, an episode or a plan from above as SVG, or a camera frame as PNG.
    #[command(disable_help_flag = true)]
    Draw(Delegated),
    /// Train a policy while the process set drives: the paper's experiment.
    #[command(disable_help_flag = true)]
    Train(Delegated),
    /// Train a policy anew on all that a training recorded.
    #[command(disable_help_flag = true)]
    Relearn(Delegated),
    /// Drive episodes for a training on another machine.
    #[command(disable_help_flag = true)]
    Actor(Delegated),
    /// Train under a judge that is wrong, silent or late, and print what it costs.
    #[command(disable_help_flag = true)]
    Sweep(Delegated),
    /// Recompute a recorded run with this build and compare it bit by bit.
    #[command(disable_help_flag = true)]
    Replay(Delegated),
    /// Drive on from a recorded tick: with another policy, planner, judge or setting.
    #[command(disable_help_flag = true)]
    Fork(Delegated),
    /// Print the script with which a cluster does a command's work in parts.
    Cluster(Cluster),
    /// Drive on from every veto, takeover, contact and late tick of many recordings.
    #[command(disable_help_flag = true)]
    Regress(Delegated),
    /// Write a recording as an animation, as tables, or as a dataset.
    #[command(disable_help_flag = true)]
    Export(Delegated),
    /// Audit what a judge was asked and said, ask another model the same, train a small net
    /// on it, or serve a stand-in for a model.
    #[command(disable_help_flag = true)]
    Judge(Delegated),
    /// Other machines: invite a judge, a learner or a view; serve rows; show what was refused.
    Link(Link),
    /// Be the judge, learner, view or recorder of a set that drives on another machine.
    Join(Join),
}
