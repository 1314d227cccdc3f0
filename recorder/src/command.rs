//! `./vlaps record`.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::{Args, Parser};
use recorder::process::{self, ByHand};
use shm_config::run::RunName;
use shm_config::text::printable_lines;

/// Record a running set as one reader more, until the set ends or Ctrl-C.
#[derive(Parser)]
#[command(
    name = "record",
    bin_name = "./vlaps record",
    after_help = "It begins with the messages that come now; ./vlaps up --record records a run \
        from its start. Messages that it could not read or write in time are counted and named \
        at the end.\n\n\
        Examples:\n  \
        ./vlaps record default --out rec\n  \
        ./vlaps record default --out rec --seconds 60\n  \
        ./vlaps record default --out rec --flight\n  \
        ./vlaps record default --now"
)]
pub struct Record {
    /// Name of the run.
    run: RunName,
    #[command(flatten)]
    what: What,
}

#[derive(Args)]
struct What {
    /// Folder of the recording; it must be missing, or have no file ending in .mcap.
    #[arg(long, value_name = "DIR", required_unless_present = "now")]
    out: Option<PathBuf>,
    /// Seconds to record; without it until the run ends.
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_negative_numbers = true,
          value_parser = seconds)]
    seconds: f64,
    /// Keep the last 60 s in memory, and write them on a veto, contact, takeover, late tick or
    /// fault, and at the end.
    #[arg(long)]
    flight: bool,
    /// Let the run's own flight recorder (record.keep = "flight") write now.
    #[arg(long, conflicts_with_all = ["out", "flight", "seconds"])]
    now: bool,
}

/// A day, s.
const SECONDS_MAX: f64 = 86_400.0;

fn seconds(text: &str) -> Result<f64, String> {
    let seconds = text.parse().map_err(|_| "not a number".to_string())?;
    match (0.0..=SECONDS_MAX).contains(&seconds) {
        true => Ok(seconds),
        false => Err(format!("not between 0 and {SECONDS_MAX}")),
    }
}

/// Carries out `record`; exit code 2 when it cannot.
pub fn record(arguments: &Record) -> ExitCode {
    let done = match &arguments.what.out {
        None => process::write_now(&arguments.run),
        Some(out) => by_hand(arguments, out.clone()),
    };
    match done {
        Ok(text) => {
            println!("{}", printable_lines(&text));
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("error: {}", printable_lines(&error.to_string()));
            ExitCode::from(2)
        }
    }
}

fn by_hand(arguments: &Record, out: PathBuf) -> Result<String, runtime::SetUpError> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, stop.clone())?;
    }
    let what = ByHand {
        run: arguments.run.clone(),
        out,
        seconds: arguments.what.seconds,
        flight: arguments.what.flight,
    };
    process::by_hand(&what, &stop)
}
