//! `bench replay`: replays and forks rehearsed recordings, and measures how long both take.
//!
//! | module | holds |
//! |---|---|
//! | `recordings` | the rehearsed runs as files |
//! | `forks` | forks without a change, and many with another policy |

mod forks;
mod recordings;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;

use clap::Args;
use lab::progress::Progress;
use lab::replay::recorded::Recorded;
use lab::replay::run::{PROCESSES, Task, replay};
use lab::report::{Machine, table};
use rayon::prelude::*;
use serde::Serialize;
use stack::Clock;
use supervisor::subcommand::{Output, Subcommand, say, seconds, write_json_option};

use forks::{Drives, Unchanged};
use recordings::Recordings;

/// Replay and fork rehearsed recordings, and measure both.
#[derive(Debug, Args)]
#[command(
    after_help = "The runs are rehearsed in this process with the shipped code: real time at \
        10 Hz with late and lost ticks, restarts of every process, new weights, a judge and a \
        person. They are written as the recorder writes them, and read from there.\n\n\
        Exit code: 0, no byte differs and each fork without a change is its recording; 1, one \
        differs.\n\n\
        Examples:\n  \
        ./vlaps bench replay\n  \
        ./vlaps bench replay --recordings 200 --drives 1000 --seconds 10 --json replay.json\n  \
        ./vlaps bench replay --recordings 50 --drives 0 --keep recordings"
)]
pub struct BenchReplay {
    /// Recordings, each forked once at a random tick without a change.
    #[arg(long, value_name = "N", default_value_t = 200,
          value_parser = clap::value_parser!(u64).range(1..=10_000))]
    pub recordings: u64,
    /// Ticks of each.
    #[arg(long, value_name = "N", default_value_t = 400,
          value_parser = clap::value_parser!(u64).range(100..=100_000))]
    pub ticks: u64,
    /// Forks at random ticks that are driven on with another policy.
    #[arg(long, value_name = "N", default_value_t = 1000,
          value_parser = clap::value_parser!(u64).range(0..=1_000_000))]
    pub drives: u64,
    /// Seconds that each of them is driven.
    #[arg(long, value_name = "S", default_value = "10", value_parser = seconds)]
    pub seconds: f64,
    /// Leave the recordings and the policy in this folder, which must not exist.
    #[arg(long, value_name = "DIR")]
    pub keep: Option<PathBuf>,
    /// Also write the results to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Replays of all recordings.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Replays {
    /// Ticks that were recomputed.
    pub ticks: u64,
    /// Messages that were recomputed.
    pub recomputed: u64,
    /// Messages that could not be, because what they depend on is not recorded.
    pub not_recomputable: u64,
    /// Bytes that differ.
    pub different_bytes: u64,
    /// Recorded time, s.
    pub recorded_s: f64,
    /// Time of the replays, s.
    pub elapsed_s: f64,
    /// Recorded time over that.
    pub times_real_time: f64,
}

/// All results.
#[derive(Clone, Debug, Serialize)]
pub struct ReplayResults {
    /// The recordings.
    pub recordings: u64,
    /// Bytes of their files.
    pub bytes: u64,
    /// Replays of all of them.
    pub replays: Replays,
    /// A fork without a change of each.
    pub unchanged: Unchanged,
    /// Forks with another policy.
    pub drives: Drives,
    /// The machine.
    pub conditions: Machine,
}

impl Subcommand for BenchReplay {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let recordings = Recordings::rehearse(self, clock)?;
        let results = ReplayResults {
            recordings: self.recordings,
            bytes: recordings.bytes()?,
            replays: replays(&recordings, clock)?,
            unchanged: forks::unchanged(&recordings, clock)?,
            drives: forks::drives(self, &recordings, clock)?,
            conditions: Machine::here()?,
        };
        print(&results);
        write_json_option(&self.json, &results)?;
        let is_equal = results.replays.different_bytes == 0
            && results.unchanged.identical == results.unchanged.forks;
        Ok(match is_equal {
            true => ExitCode::SUCCESS,
            false => ExitCode::from(1),
        })
    }
}

/// Replays one recording after the other, each on all cores.
fn replays(recordings: &Recordings, clock: Clock) -> anyhow::Result<Replays> {
    let task = Task {
        processes: PROCESSES.to_vec(),
        from: 0,
        tick: None,
    };
    let files = recordings.files();
    let mut bar = Progress::begin(
        "replay".into(),
        "recordings",
        (0, files.len() as u64),
        clock,
    )?;
    let begun = clock();
    let mut all = Replays::default();
    for (done, path) in files.iter().enumerate() {
        let replayed = replay(&mut Recorded::open(path)?, &task, clock, |_| {})?;
        all.ticks += replayed.ticks;
        all.recorded_s += replayed.recorded_s;
        all.different_bytes += replayed.different_bytes;
        for row in &replayed.processes {
            all.recomputed += row.tally.recomputed;
            all.not_recomputable += row.tally.unknown;
        }
        if let Some(first) = replayed.first_difference {
            bar.warn(&format!("{}: {first:?}", path.display()));
        }
        bar.at(done as u64 + 1);
    }
    bar.end();
    all.elapsed_s = clock().since_ns(begun) as f64 * 1e-9;
    all.times_real_time = all.recorded_s / all.elapsed_s.max(1e-9);
    Ok(all)
}

/// Works on all items on all cores, under a bar.
fn in_parallel<T: Sync, R: Send>(
    (name, unit): (&str, &'static str),
    items: &[T],
    clock: Clock,
    work: impl Fn(&T) -> anyhow::Result<R> + Sync,
) -> anyhow::Result<Vec<R>> {
    let bar = Progress::begin(name.into(), unit, (0, items.len() as u64), clock)?;
    let bar = Mutex::new((bar, 0));
    let each = |item| {
        let result = work(item);
        if let Ok(mut bar) = bar.lock() {
            bar.1 += 1;
            let done = bar.1;
            // Without a terminal each call is a line.
            if done % items.len().div_ceil(10).max(1) as u64 == 0 {
                bar.0.at(done);
            }
        }
        result
    };
    let results = items.par_iter().map(each).collect();
    if let Ok((bar, _)) = bar.into_inner() {
        bar.end();
    }
    results
}

fn print(results: &ReplayResults) {
    let mut rows = table(&["", "", ""]);
    let (replays, unchanged, drives) = (&results.replays, &results.unchanged, &results.drives);
    let mut add = |what: &str, figure: String, detail: String| {
        rows.add_row([what.to_string(), figure, detail]);
    };
    add(
        "recordings",
        results.recordings.to_string(),
        format!("{:.1} MB", results.bytes as f64 / 1e6),
    );
    add(
        "replay, bytes that differ",
        replays.different_bytes.to_string(),
        format!(
            "of {} messages, {} ticks",
            replays.recomputed, replays.ticks
        ),
    );
    add(
        "replay, times real time",
        format!("{:.0}", replays.times_real_time),
        format!("{:.0} s in {:.1} s", replays.recorded_s, replays.elapsed_s),
    );
    add(
        "forks without a change, identical",
        format!("{} of {}", unchanged.identical, unchanged.forks),
        format!("{} ticks in {:.1} s", unchanged.ticks, unchanged.elapsed_s),
    );
    add(
        "forks with another policy",
        drives.forks.to_string(),
        format!(
            "{:.0} s driven in {:.1} s: {:.0} forks a minute",
            drives.driven_s, drives.elapsed_s, drives.forks_per_minute
        ),
    );
    say(rows);
    say(format_args!("{}", results.conditions));
}
