//! The command `./vlaps replay`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::bail;
use clap::Args;
use serde::Serialize;
use shm_config::config::{Config, planner::Method};
use shm_config::counted;
use shm_config::services::Process;
use stack::Clock;
use supervisor::subcommand::{Output, Subcommand, say, settings, write_json_option};

use super::recorded::Recorded;
use super::run::{PROCESSES, Replayed, Task, replay};
use super::source::Source;
use super::what_if;
use crate::fork::cannot;
use crate::progress::Progress;
use crate::report::table;

/// Recompute a recorded run with this build and compare it bit by bit.
#[derive(Debug, Args)]
#[command(
    after_help = "World, planner, controller, gate and learner are recomputed from the recorded inputs: \
        the world from the seed and the applied commands, a plan from its observation, a tick \
        with its safety check and the policy's proposals from its step, advice and the learner's \
        weights from the steps. \
        The answers of a model and the actions of a person are inputs. With --driver or --set \
        the run is not compared but asked: what would another planner, limit or judge have \
        said at each recorded tick?\n\n\
        Exit code: 0, every byte is equal; 1, one differs; 2, the recording cannot be \
        replayed.\n\n\
        Examples:\n  \
        ./vlaps replay runs/default/recording\n  \
        ./vlaps replay REC --process planner --from 1200 --json replay.json\n  \
        ./vlaps replay REC --tick 1234\n  \
        ./vlaps replay REC --driver mpc --plot mpc.svg\n  \
        ./vlaps replay REC --set safety.margin_m=0.6"
)]
pub struct Replay {
    /// The recording: a folder with MCAP files of one run, or one file.
    #[arg(value_name = "REC")]
    pub recording: PathBuf,
    /// Recompute this process alone: world, planner, controller, gate or
    /// learner.
    #[arg(long, value_name = "PROCESS", value_parser = process)]
    pub process: Option<Process>,
    /// Tell differences from this tick on.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub from: u64,
    /// Tell differences of this tick alone.
    #[arg(long, value_name = "N")]
    pub tick: Option<u64>,
    /// What another planner would have said: rrt-star, informed, kinodynamic or mpc.
    #[arg(long, value_name = "DRIVER", value_parser = method)]
    pub driver: Option<Method>,
    /// What another setting would have led to, such as safety.margin_m=0.6; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Plot the recorded and the other commands into this file, SVG.
    #[arg(long, value_name = "FILE")]
    pub plot: Option<PathBuf>,
    /// Write the figures to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// A process that can be recomputed.
fn process(text: &str) -> Result<Process, String> {
    let words = PROCESSES.map(Process::word).join(", ");
    let found = PROCESSES.into_iter().find(|process| process.word() == text);
    found.ok_or_else(|| format!("must be one of {words}"))
}

/// A planner by its name.
pub fn method(text: &str) -> Result<Method, String> {
    let kind: stack::driver::DriverKind = text.parse()?;
    let method = kind.method();
    method.ok_or_else(|| "must be rrt-star, informed, kinodynamic or mpc".into())
}

/// The recorded configuration with another planner and other settings.
///
/// # Errors
/// When a setting is wrong.
pub fn changed(
    recorded: &Recorded,
    method: Option<Method>,
    overrides: &[String],
) -> anyhow::Result<Config> {
    let mut config = match overrides {
        [] => recorded.config().clone(),
        overrides => settings::changed(&recorded.configuration()?, overrides)?,
    };
    if let Some(method) = method {
        config.planner.method = method;
    }
    Ok(config)
}

/// The figures of a replay.
#[derive(Debug, Serialize)]
struct Figures {
    #[serde(flatten)]
    replayed: Replayed,
    /// The file of the first difference.
    file: Option<PathBuf>,
    /// How long it took, s.
    elapsed_s: f64,
    /// Recorded time over that.
    times_real_time: f64,
}

impl Subcommand for Replay {
    fn outputs(&self) -> Vec<Output> {
        vec![
            Output::File("--plot", self.plot.clone()),
            Output::json(&self.json),
        ]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        self.replay(clock).map_err(cannot)
    }
}

impl Replay {
    fn replay(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let is_asked = self.driver.is_some() || !self.overrides.is_empty();
        if self.plot.is_some() && !is_asked {
            bail!("--plot draws what --driver or --set would have led to: give one of them");
        }
        if self.process.is_some() && is_asked {
            bail!("--process compares with the recording, --driver and --set do not: give one");
        }
        let mut recorded = Recorded::open(&self.recording)?;
        recorded.verify()?;
        for line in recorded.damage() {
            say(format_args!("note: {line}"));
        }
        if is_asked {
            let config = changed(&recorded, self.driver, &self.overrides)?;
            let asked = what_if::ask(&mut recorded, &config, (self.from, self.tick))?;
            say(asked.table());
            if let Some(file) = &self.plot {
                asked.plot(file)?;
                say(format_args!("plot: {}", file.display()));
            }
            write_json_option(&self.json, &asked)?;
            return Ok(ExitCode::SUCCESS);
        }
        let task = Task {
            processes: self.process.map_or(PROCESSES.to_vec(), |only| vec![only]),
            from: self.tick.unwrap_or(self.from),
            tick: self.tick,
        };
        let (first_ns, last_ns) = recorded.span_ns().unwrap_or_default();
        let span_s = last_ns.saturating_sub(first_ns) / 1_000_000_000;
        let mut bar = Progress::begin("replay".into(), "s", (0, span_s), clock)?;
        let begun = clock();
        let mut from_ns = None;
        let replayed = replay(&mut recorded, &task, clock, |at_ns| {
            let from_ns = *from_ns.get_or_insert(at_ns);
            bar.at(at_ns.saturating_sub(from_ns) / 1_000_000_000);
        })?;
        bar.end();
        let elapsed_s = clock().since_ns(begun) as f64 * 1e-9;
        let first = replayed.first_difference.as_ref();
        let file = first.and_then(|first| recorded.file_at(first.taken_ns));
        let figures = Figures {
            file: file.map(PathBuf::from),
            times_real_time: replayed.recorded_s / elapsed_s.max(1e-9),
            replayed,
            elapsed_s,
        };
        tell(&figures);
        write_json_option(&self.json, &figures)?;
        Ok(match figures.replayed.different {
            0 => ExitCode::SUCCESS,
            _ => ExitCode::from(1),
        })
    }
}

/// Prints what was found.
fn tell(figures: &Figures) {
    let replayed = &figures.replayed;
    let mut rows = table(&["process", "recomputed", "different", "not recomputable"]);
    for row in &replayed.processes {
        let tally = &row.tally;
        rows.add_row([
            row.process.to_string(),
            tally.recomputed.to_string(),
            tally.different.to_string(),
            tally.unknown.to_string(),
        ]);
    }
    say(rows);
    for hash in &replayed.missing_policies {
        say(format_args!(
            "note: the policy {hash} is not in the recording; its proposals are taken as recorded"
        ));
    }
    for why in &replayed.not_recomputed {
        say(format_args!("note: not recomputed: {why}"));
    }
    say(format_args!(
        "{} recomputed in {:.1} s, {:.0} times real time",
        counted(replayed.ticks, "tick"),
        figures.elapsed_s,
        figures.times_real_time
    ));
    match &replayed.first_difference {
        None => say("every byte is equal"),
        Some(first) => say(format_args!(
            "{} and {} differ; the first: {}, tick {}, {}, {}: recorded {}, recomputed {}",
            counted(replayed.different, "message"),
            counted(replayed.different_bytes, "byte"),
            figures.file.as_deref().unwrap_or(Path::new("")).display(),
            first.tick,
            first.process,
            first.field,
            first.recorded,
            first.recomputed
        )),
    }
}
