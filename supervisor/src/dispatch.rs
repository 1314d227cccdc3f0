//! Which function or program carries out each command of `./vlaps`.

use crate::Clock;
use crate::arguments::Command;
use crate::cli::failure::Failure;
use crate::commands::delegate::{BENCH, Delegated, JUDGE, LAB, LINK, RECORDER, VIEW, delegate};
use crate::commands::{clean, cluster, config, conform, doctor, down, setup, status, swap, up};

/// Carries out a command; those of other programs are handed over.
///
/// # Errors
/// What the command could not do, with the exit code of it.
pub fn carry_out(command: &Command, clock: Clock) -> Result<(), Failure> {
    match command {
        Command::Up(arguments) => up::up(arguments, clock),
        Command::Down(arguments) => down::down(arguments),
        Command::Status(arguments) => status::status(arguments, clock),
        Command::Swap(arguments) => swap::swap(arguments, clock),
        Command::Doctor => doctor::doctor(clock),
        Command::Clean(arguments) => clean::clean(arguments),
        Command::Record(words) => delegate(RECORDER, &["record"], words),
        Command::Setup(arguments) => setup::setup(arguments),
        Command::Cluster(arguments) => cluster::cluster(arguments),
        Command::Config(arguments) => config::config(arguments),
        Command::Conform(arguments) => conform::conform(arguments, clock),
        Command::Eval(words) => delegate(LAB, &["eval"], words),
        Command::Bench(words) => delegate(BENCH, &["bench"], words),
        Command::View(words) => delegate(VIEW, &["view"], words),
        Command::Draw(words) => delegate(LAB, &["draw"], words),
        Command::Judge(words) => delegate(JUDGE, &[], words),
        Command::Train(words) => delegate(LAB, &["train"], words),
        Command::Actor(words) => delegate(LAB, &["actor"], words),
        Command::Sweep(words) => delegate(LAB, &["sweep"], words),
        Command::Replay(words) => delegate(LAB, &["replay"], words),
        Command::Fork(words) => delegate(LAB, &["fork"], words),
        Command::Regress(words) => delegate(LAB, &["regress"], words),
        Command::Link(_) | Command::Join(_) => delegate(LINK, &[], &Delegated::own()),
        Command::Relearn(words) => delegate(LAB, &["relearn"], words),
        Command::Export(words) => delegate(LAB, &["export"], words),
    }
}
