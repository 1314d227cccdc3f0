//! `swap`: offers policy weights to a running set, and reports the result.

pub mod offers;

use crate::cli::parsers::Name;
use clap::Args;
use shm_config::run::RunName;
use std::path::Path;
use std::path::PathBuf;

use shm_config::file;
use shm_config::message::WEIGHTS_BYTES_MAX;
use shm_config::run::RunPaths;
use shm_config::services::Process;
use shm_config::wire::Wire;

use crate::Clock;
use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::run::leftovers::clean_run;
use crate::run::selection::select_run;
use crate::run::target::Target;
use offers::{ANSWER_NS, Answer, Offers};

/// Offer policy weights to a running set; exit code 0 when they are adopted.
#[derive(Debug, Args)]
#[command(
    after_help = "The set checks size, hash, format, observation layout, operators, shapes, \
        weights and probes, warms the net, and adopts it between two ticks. It then proposes in \
        shadow mode for policy.shadow_ticks, its canary period, before it may drive.\n\n\
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
    /// Also wait for the end of the canary period; exit code 1 when it is not passed.
    #[arg(long)]
    pub wait_ready: bool,
}

/// Offers of which another publisher took the version first.
const TRIES: u32 = 5;

/// Offers a file to a running set.
///
/// # Errors
/// When the file cannot be read, no set runs, or the weights are refused.
pub fn swap(arguments: &Swap, clock: Clock) -> Result<(), Failure> {
    let bytes = read(&arguments.file)?;
    let name = arguments.run.as_ref();
    let chosen = select_run(name)?;
    let alive = match &chosen {
        // The process that holds the run must be its supervisor.
        Some(paths) => Target::of(paths)?.map(|_| paths),
        None => None,
    };
    let Some(paths) = alive else {
        return Err(Failure::GivenUp(match name {
            Some(name) => {
                format!("run '{name}' is not running; `./vlaps up --run {name}` starts it")
            }
            None => "nothing runs; `./vlaps up` starts a run".into(),
        }));
    };
    let offered = offer(paths, arguments, &bytes, clock);
    // If the run has ended in the meantime, this process has kept its files from
    // removal.
    if paths.supervisor_pid().is_none() {
        clean_run(paths)?;
    }
    offered
}

fn offer(paths: &RunPaths, arguments: &Swap, bytes: &[u8], clock: Clock) -> Result<(), Failure> {
    let wire = Wire::join(paths.name(), Process::Supervisor)?;
    let mut offers = Offers::open(&wire)?;
    let file = arguments.file.display();
    for _ in 0..TRIES {
        let version = offers.next_version(clock);
        if !offers.offer(version, bytes) {
            return Err(Failure::GivenUp(format!(
                "{file}: shared memory has no room for it; `./vlaps doctor` shows the space"
            )));
        }
        let name = paths.name();
        match offers.answer(version, bytes, clock, ANSWER_NS)? {
            Answer::Overtaken(_) => continue,
            Answer::Refused(reason) => {
                return Err(Failure::GivenUp(format!("{file}: refused: {reason}")));
            }
            Answer::Adopted { tick } => {
                say(format_args!(
                    "adopted at tick {tick}: {file} is version {version} of run '{name}', in \
                     shadow first"
                ));
                return match arguments.wait_ready {
                    true => offers.await_ready(version, bytes, clock),
                    false => Ok(()),
                };
            }
            Answer::Ready { tick } => {
                say(format_args!(
                    "adopted at tick {tick}: {file} is version {version} of run '{name}' and may \
                     drive"
                ));
                offers.warn_of_unkept();
                return Ok(());
            }
        }
    }
    Err(Failure::GivenUp(format!(
        "{file}: refused: other weights were offered at the same time {TRIES} times; try again"
    )))
}

/// Reads the file, if an offer can carry it.
fn read(path: &Path) -> Result<Vec<u8>, Failure> {
    let failed = |error: std::io::Error| {
        Failure::Usage(format!(
            "{}: {error}; name a policy file, such as policy.onnx",
            path.display()
        ))
    };
    let bytes = file::regular(path).map_err(failed)?.len();
    if bytes > WEIGHTS_BYTES_MAX as u64 {
        return Err(Failure::GivenUp(format!(
            "{}: refused: {bytes} bytes are over the limit of {WEIGHTS_BYTES_MAX}",
            path.display()
        )));
    }
    file::read(path, WEIGHTS_BYTES_MAX as u64).map_err(failed)
}
