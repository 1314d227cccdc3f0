//! `bench latency`: measures the punctuality of a running set under load.

pub mod arguments;
pub mod buckets;
mod cyclictest;
mod drive;
mod judges;
mod link;
pub mod pairs;
mod pictures;
mod recording;
mod ros;
pub mod row;
mod row_store;
mod stress;
mod tables;
mod viewers;
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
use row_store::RowStore;
use stack::Clock;
use stress::Maker;
use supervisor::subcommand::settings;
use supervisor::subcommand::{say, write_json, write_json_option};

/// All rows.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// In the requested order.
    pub rows: Vec<Row>,
    /// Number of requested rows that were not driven because of a stop request.
    pub left: usize,
    /// Comparisons of rows with a load and rows without; empty without pairs.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub paired: Vec<pairs::Paired>,
    /// The machine.
    pub conditions: Machine,
}

/// Settings that all rows share.
struct Bench<'a> {
    settings: Settings,
    maker: Maker,
    cyclictest: bool,
    /// Whether the user requires cyclictest, so that its failure is an error.
    insist: bool,
    policy: &'a Path,
    /// Folder for temporary files.
    scratch: &'a Path,
    /// Folder on the disk that is loaded: that of the results.
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
        // Without a policy there is no proposal to judge; its actions do not matter.
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
        // All configurations are checked before the first row.
        for case in &cases {
            drive::configuration(&bench, case).with_context(|| case.words())?;
        }
        let store = RowStore::open(self.out.as_deref())?;
        stress::remove_stale(bench.disk);
        if self.fresh {
            cases.iter().for_each(|case| store.forget(case));
        }
        let mut rows = Vec::new();
        let done = measure(&bench, &cases, &store, &mut rows);
        let measured = Measured {
            left: cases.len() - rows.len(),
            paired: pairs::of(&cases, &rows),
            rows,
            conditions,
        };
        tables::print(&measured, self.seconds);
        pairs::print(&measured.paired);
        done?;
        write(
            self,
            &measured,
            &store.series(&cases[..measured.rows.len()])?,
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

/// Adds a row for each case, kept or measured, until a stop is requested.
///
/// # Errors
/// If a row cannot be measured or kept. `rows` then holds all rows until then,
/// including the one that could not be kept.
fn measure(
    bench: &Bench<'_>,
    cases: &[Case],
    store: &RowStore,
    rows: &mut Vec<Row>,
) -> anyhow::Result<()> {
    let kept = cases.iter().map(|case| store.kept(case, &bench.settings));
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
            let kept = store.keep(case, &row, &series);
            rows.push(row);
            kept?;
        }
        progress.at(rows.len() as u64);
    }
    progress.end();
    Ok(())
}

/// Writes the requested files; nothing if there are no rows.
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
            "rows, histograms and plots: {}",
            out.display()
        ));
    }
    write_json_option(&arguments.json, measured)
}

/// A command for a program that runs beside a set. Where setpriv(1) is installed, the
/// kernel ends the program with this one, even after a kill. Ctrl-C in the terminal does
/// not reach it, since the row is discarded first.
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

/// Whether a program is on PATH and succeeds with these arguments.
fn answers(program: &str, words: &[&str]) -> bool {
    let mut command = Command::new(program);
    command.args(words).stdin(Stdio::null());
    let status = command.stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok()
}
