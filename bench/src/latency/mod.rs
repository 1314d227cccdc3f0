//! `bench latency`: is the set punctual under each load beside it?

pub mod arguments;
pub mod buckets;
mod cyclictest;
mod drive;
mod judges;
mod pictures;
pub mod row;
mod shelf;
mod stress;
mod tables;
mod watch;

use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::ExitCode;
use std::process::{Command, Stdio};
use supervisor::subcommand::{Output, Subcommand};

use anyhow::Context;
use policy::{Provenance, encode};
use serde::Serialize;

use crate::inference::net;
pub use arguments::BenchLatency;
use arguments::{Case, FloorChoice, OWN_KEYS, Settings};
use buckets::Series;
use lab::progress::Progress;
use lab::report::Machine;
use lab::stop::Stop;
use row::{METHOD, Row};
use shelf::Shelf;
use stack::Clock;
use stress::Maker;
use supervisor::subcommand::settings;
use supervisor::subcommand::{say, write_json, write_json_option};

/// All rows.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// In the order in which they were asked for.
    pub rows: Vec<Row>,
    /// Rows that were asked for and not driven, since a stop was requested.
    pub left: usize,
    /// Where.
    pub conditions: Machine,
}

/// What all rows have in common.
struct Bench<'a> {
    settings: Settings,
    maker: Maker,
    cyclictest: bool,
    /// The floor must be by cyclictest: the user said so.
    insist: bool,
    policy: &'a Path,
    /// Folder of what goes with the benchmark.
    scratch: &'a Path,
    /// The disk that is loaded: the one that results go to.
    disk: &'a Path,
    stop: Stop,
    clock: Clock,
}

impl Subcommand for BenchLatency {
    fn outputs(&self) -> Vec<Output> {
        vec![
            Output::Folder("--out", self.out.clone()),
            Output::json(&self.json),
        ]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        settings::refuse_own(&self.overrides, &OWN_KEYS)?;
        let conditions = Machine::here()?;
        let folder = tempfile::tempdir()?;
        // Without a policy there is nothing to judge; its actions do not matter.
        let policy = folder.path().join("policy.onnx");
        let bytes = encode(&net(256, 0), &Provenance::default(), &[vec![0.5; 259]]);
        std::fs::write(&policy, bytes).with_context(|| policy.display().to_string())?;
        let maker = Maker::of(self.stress)?;
        let cyclictest = is_by_cyclictest(self.floor)?;
        let floor = if cyclictest {
            "cyclictest"
        } else {
            "own thread"
        };
        let bench = Bench {
            settings: Settings {
                seconds: self.seconds,
                method: METHOD,
                overrides: self.overrides.clone(),
                stress: maker.word().into(),
                floor: floor.into(),
            },
            maker,
            cyclictest,
            insist: self.floor == FloorChoice::Cyclictest,
            policy: &policy,
            scratch: folder.path(),
            disk: self.out.as_deref().unwrap_or(folder.path()),
            stop: Stop::listen()?,
            clock,
        };
        let cases = self.cases();
        // All of them before the first: an impossible row is an error at once.
        for case in &cases {
            drive::configuration(&bench, case).with_context(|| case.words())?;
        }
        let shelf = Shelf::open(self.out.as_deref())?;
        stress::remove_stale(bench.disk);
        if self.fresh {
            cases.iter().for_each(|case| shelf.forget(case));
        }
        let mut rows = Vec::new();
        let done = measure(&bench, &cases, &shelf, &mut rows);
        let measured = Measured {
            left: cases.len() - rows.len(),
            rows,
            conditions,
        };
        tables::print(&measured, self.seconds);
        done?;
        write(
            self,
            &measured,
            &shelf.series(&cases[..measured.rows.len()])?,
        )?;
        match measured.left {
            0 => Ok(ExitCode::SUCCESS),
            left if self.fresh => {
                anyhow::bail!(
                    "stopped, {left} rows are left; the same command without --fresh continues"
                )
            }
            left if self.out.is_some() => {
                anyhow::bail!("stopped, {left} rows are left; the same command continues")
            }
            left => anyhow::bail!("stopped, {left} rows are left; with --out rows are kept"),
        }
    }
}

fn is_by_cyclictest(choice: FloorChoice) -> anyhow::Result<bool> {
    match choice {
        FloorChoice::Own => Ok(false),
        FloorChoice::Auto => Ok(cyclictest::is_there()),
        FloorChoice::Cyclictest if cyclictest::is_there() => Ok(true),
        FloorChoice::Cyclictest => anyhow::bail!(
            "--floor cyclictest: it is not on PATH; `sudo apt-get install rt-tests`, or --floor own"
        ),
    }
}

/// Adds a row for each case, kept or driven, until a stop is requested.
///
/// # Errors
/// When one cannot be driven or kept. The rows until then are there, the one that could
/// not be kept among them.
fn measure(
    bench: &Bench<'_>,
    cases: &[Case],
    shelf: &Shelf,
    rows: &mut Vec<Row>,
) -> anyhow::Result<()> {
    let kept = cases.iter().map(|case| shelf.kept(case, &bench.settings));
    let kept = kept.collect::<Result<Vec<_>, _>>()?;
    let total = cases.len() as u64;
    let mut progress = Progress::begin("latency".into(), "rows", (0, total), bench.clock)?;
    for (k, (case, kept)) in cases.iter().zip(kept).enumerate() {
        if let Some(row) = kept {
            rows.push(row);
        } else {
            progress.now(&case.words());
            let driven = drive::drive(bench, case, k).with_context(|| case.words())?;
            let Some((row, series)) = driven else {
                break;
            };
            let kept = shelf.keep(case, &row, &series);
            rows.push(row);
            kept?;
        }
        progress.at(rows.len() as u64);
    }
    progress.end();
    Ok(())
}

/// Writes what the options ask for; nothing of no rows.
fn write(
    arguments: &BenchLatency,
    measured: &Measured,
    series: &[Vec<Series>],
) -> anyhow::Result<()> {
    if measured.rows.is_empty() {
        return Ok(());
    }
    if let Some(out) = &arguments.out {
        pictures::draw(&measured.rows, series, out)?;
        write_json(&out.join("latency.json"), measured)?;
        say(format_args!(
            "rows, histograms and pictures: {}",
            out.display()
        ));
    }
    write_json_option(&arguments.json, measured)
}

/// A program beside a set. The kernel ends it when this one has ended, however it did,
/// where setpriv(1) is there to ask for that; Ctrl-C in the terminal does not reach it,
/// since what is measured beside it is given up first.
fn beside(program: &str) -> Command {
    let tie = ["--pdeathsig", "TERM"];
    let mut tied = Command::new("setpriv");
    tied.args(tie).arg(program);
    let mut probe = Command::new("setpriv");
    let probe = probe.args(tie).arg("true").stderr(Stdio::null()).status();
    let mut command = match probe {
        Ok(status) if status.success() => tied,
        _ => Command::new(program),
    };
    command.process_group(0);
    command
}

/// A program is on PATH and answers.
fn answers(program: &str, words: &[&str]) -> bool {
    let mut command = Command::new(program);
    command.args(words).stdin(Stdio::null());
    let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok()
}
