//! `./vlaps view`: its options, and the program from start to end.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use shm_config::run::{RunName, RunPaths};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use supervisor::Clock;
use supervisor::cli::failure::Failure;
use supervisor::cli::parsers::{Name, whole};
use supervisor::run::selection::alive;
use supervisor::subcommand::{Output, Subcommand, say, write_json_option};

use super::fleet::{Fleet, watch};
use super::foxglove::{Board, FoxgloveServer};
use super::hub::Hub;
use super::reader::{Boards, STACK_BYTES, Wanted, read};
use super::server::Server;
use super::source::Source;
use super::tape::Tape;

/// The port of the page; no well-known service has it.
const PORT: &str = "8090";
/// The port at which Foxglove and Lichtblick look first.
const FOXGLOVE_PORT: &str = "8765";

/// Show a running set, all of them, or a recording, as a page for a browser.
#[derive(Debug, Args)]
#[command(
    after_help = "The page reads and changes nothing; it makes no tick late. It follows the run \
        through its end and its return. With --bind other machines can open it: the printed \
        address then holds a random token, and any browser with it can watch. ? on the page shows \
        its keys.\n\n\
        --all shows a card for each run of this user on this machine, and so also for the runs \
        that ./vlaps join mirrors from other machines. Runs that need attention come first; a \
        click opens the page of one run.\n\n\
        Exit code 2: the port is taken, or no run or recording has this name.\n\n\
        Examples:\n  \
        ./vlaps view                              the set of this folder, now or when it starts\n  \
        ./vlaps view --run second --port 8091\n  \
        ./vlaps view --all                        all runs, a card for each\n  \
        ./vlaps view RECORDING                    play, seek, jump to the next event\n  \
        ./vlaps view --bind 0.0.0.0               for a browser on another machine\n  \
        ./vlaps view --foxglove                   for Foxglove and Lichtblick, too"
)]
pub struct View {
    /// A recording: a folder with the files of one run, or one file; without it, a living
    /// run.
    #[arg(value_name = "REC", conflicts_with = "run")]
    pub recording: Option<PathBuf>,
    /// Name of the run; without it, the one set of this folder.
    #[arg(long, value_name = "NAME", value_parser = Name)]
    pub run: Option<RunName>,
    /// Show all runs of this user on this machine, those mirrored from other machines too.
    #[arg(long, conflicts_with_all = ["recording", "run", "foxglove"])]
    pub all: bool,
    /// Port of the page; 0 takes any free one.
    #[arg(long, value_name = "N", default_value = PORT, allow_negative_numbers = true,
          value_parser = whole::<u16>(0..=65_535))]
    pub port: u16,
    /// Address to listen on.
    #[arg(long, value_name = "ADDRESS", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST))]
    pub bind: IpAddr,
    /// Serve the run to Foxglove and Lichtblick, too, on this port; 0 takes any free one.
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = FOXGLOVE_PORT,
          conflicts_with = "recording", allow_negative_numbers = true,
          value_parser = whole::<u16>(0..=65_535))]
    pub foxglove: Option<u16>,
    /// Write the page's address to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// What `--json` writes.
#[derive(Debug, Serialize)]
struct Told {
    /// The page's address, with its token.
    url: String,
    /// The address for Foxglove.
    #[serde(skip_serializing_if = "Option::is_none")]
    foxglove: Option<String>,
}

impl Subcommand for View {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let signals = Signals::new([SIGINT, SIGTERM, SIGHUP]).context("cannot handle signals")?;
        match &self.recording {
            Some(path) => self.recorded(path, signals)?,
            None if self.all => self.fleet(clock, signals)?,
            None => self.live(signals)?,
        }
        Ok(ExitCode::SUCCESS)
    }
}

impl View {
    /// Follows a living run until a signal comes.
    fn live(&self, signals: Signals) -> anyhow::Result<()> {
        let wanted = match &self.run {
            Some(name) => {
                check_alive(name)?;
                Wanted::Named(name.clone())
            }
            None => Wanted::OfThisFolder,
        };
        // Several runs of this folder are told before the port is taken.
        let is_there = wanted.find()?.is_some();
        let hub = Arc::new(Hub::default());
        let source = Arc::new(Source::Live(hub.clone(), wanted.clone()));
        let foxglove = match self.foxglove {
            Some(port) => {
                let (address, board) = (SocketAddr::new(self.bind, port), Arc::<Board>::default());
                let server = FoxgloveServer::start(address, board.clone());
                let refused = |error| refused(address, &error, "--foxglove 0");
                Some((server.map_err(refused)?, board))
            }
            None => None,
        };
        let url = foxglove.as_ref().map(|(server, _)| server.url());
        let server = self.start(source, url)?;
        let board = foxglove.as_ref().map(|(_, board)| board.clone());
        let boards = Boards {
            hub,
            foxglove: board.clone(),
        };
        if !is_there {
            say("nothing runs yet; the page follows a set as soon as it starts");
        }
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let reader = std::thread::Builder::new()
            .name("view-reader".into())
            .stack_size(STACK_BYTES)
            .spawn(move || read(&wanted, &boards, &stopped))
            .context("cannot start the reader's thread")?;
        wait(signals);
        drop(server);
        drop(foxglove);
        stop.store(true, Ordering::Relaxed);
        // It panicked, and said so; the system frees what it held.
        let _ = reader.join();
        if let Some((sent, skipped)) = board.map(|board| board.counts()) {
            say(format_args!(
                "Foxglove: {sent} messages sent, {skipped} skipped for slow clients"
            ));
        }
        Ok(())
    }

    /// Shows all runs until a signal comes.
    fn fleet(&self, clock: Clock, signals: Signals) -> anyhow::Result<()> {
        let fleet = Arc::new(Fleet::new(clock));
        let server = self.start(Arc::new(Source::Fleet(fleet.clone())), None)?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let watcher = std::thread::Builder::new()
            .name("view-fleet".into())
            .spawn(move || watch::watch(&fleet, &stopped))
            .context("cannot start the watcher's thread")?;
        wait(signals);
        drop(server);
        stop.store(true, Ordering::Relaxed);
        // It panicked, and said so; the system frees what it held.
        let _ = watcher.join();
        Ok(())
    }

    /// Shows a recording until a signal comes.
    fn recorded(&self, path: &Path, signals: Signals) -> anyhow::Result<()> {
        let tape = Arc::new(Tape::open(path)?);
        tape.begin().context("cannot start the reader's thread")?;
        let _server = self.start(Arc::new(Source::Recorded(tape)), None)?;
        wait(signals);
        Ok(())
    }

    /// Starts the server and tells its address.
    fn start(&self, source: Arc<Source>, foxglove: Option<String>) -> anyhow::Result<Server> {
        let address = SocketAddr::new(self.bind, self.port);
        let refused = |error| refused(address, &error, "--port 0");
        let server = Server::start(address, source).map_err(refused)?;
        let url = server.url();
        let also = foxglove.iter().map(|url| format!("\nFoxglove: {url}"));
        let also: String = also.collect();
        let told = Told {
            url: url.clone(),
            foxglove,
        };
        write_json_option(&self.json, &told)?;
        say(format_args!(
            "{url}{also}\nCtrl-C stops the page; a run that it shows goes on"
        ));
        Ok(server)
    }
}

/// Why a port cannot be had, and the option that takes any.
fn refused(address: SocketAddr, error: &std::io::Error, any: &str) -> Failure {
    let hint = match error.kind() {
        std::io::ErrorKind::AddrInUse => {
            format!("; another program has it: {any} takes any free one")
        }
        std::io::ErrorKind::AddrNotAvailable => {
            "; --bind needs an address of this machine".to_string()
        }
        _ => String::new(),
    };
    Failure::Usage(format!("cannot listen on {address}: {error}{hint}"))
}

/// Refuses the name of a run that does not live.
fn check_alive(name: &RunName) -> Result<(), Failure> {
    if RunPaths::new(name.clone()).supervisor_pid().is_some() {
        return Ok(());
    }
    let others: Vec<_> = alive()?.iter().map(|run| run.name().to_string()).collect();
    Err(Failure::Usage(match others.is_empty() {
        true => format!(
            "--run {name}: nothing runs; `./vlaps up --run {name}` starts it, and \
             `./vlaps view` without --run waits for one"
        ),
        false => format!(
            "--run {name} is not running; these run: {}",
            others.join(", ")
        ),
    }))
}

/// Returns at the first signal that asks for the end.
fn wait(mut signals: Signals) {
    signals.forever().next();
}
