//! `bench latency`: is the set punctual, whatever happens beside its ticks?

mod judges;

use std::path::PathBuf;

use anyhow::Context;
use clap::{Args, ValueEnum};
use indicatif::ProgressBar;
use policy::{Provenance, encode};
use serde::Serialize;

use crate::Clock;
use crate::driven::{Driven, Punctuality};
use crate::floor::Floor;
use crate::inference::net;
use crate::report::{Machine, say, table, write_json};
use judges::Conduct;

/// Measure how punctual a running set is, by what happens beside it
#[derive(Debug, Args)]
#[command(
    after_help = "Each row is a whole process set that drives in real time. With --load gate, one \
        row for each thing a judge can do: answer at once or late, hang, refuse, send 10 MB, \
        die; the judge is the stand-in server, over HTTP. The row without a judge comes twice, \
        first and last: what differs between these two is the machine's noise.\n\n\
        Examples:\n  \
        ./vlaps bench latency\n  \
        ./vlaps bench latency --load gate --rate 10,100 --seconds 60 --json latency.json"
)]
pub struct BenchLatency {
    /// What happens beside the set.
    #[arg(
        long,
        value_name = "WHAT",
        value_delimiter = ',',
        default_value = "none,gate"
    )]
    pub load: Vec<Load>,
    /// Seconds for each row.
    #[arg(long, value_name = "S", default_value_t = 20.0, value_parser = crate::arguments::seconds)]
    pub seconds: f64,
    /// Ticks per second, one or more.
    #[arg(
        long,
        value_name = "HZ",
        value_delimiter = ',',
        default_value = "10,100"
    )]
    pub rate: Vec<f64>,
    /// Override any key of the configuration, such as planner.rate_hz=10; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// What happens beside the set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Load {
    /// Nothing.
    None,
    /// A judge that answers, hangs, refuses, floods or dies.
    Gate,
}

/// One run of the set.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Ticks a second asked for.
    pub rate_hz: f64,
    /// What happened beside it.
    pub beside: String,
    /// Questions that the judge had.
    pub questions: u64,
    /// The world.
    pub world: Punctuality,
    /// The controller.
    pub controller: Punctuality,
    /// A thread beside it that only wakes up, at the same rate and priority.
    pub floor: Punctuality,
}

/// All rows.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// In the order in which they were driven.
    pub rows: Vec<Row>,
    /// Seconds driven for each.
    pub seconds: f64,
    /// Where.
    pub conditions: Machine,
}

/// `./vlaps bench latency`.
///
/// # Errors
/// When a set does not start, or fails.
pub fn bench(arguments: &BenchLatency, clock: Clock) -> anyhow::Result<()> {
    let conditions = Machine::here()?;
    let folder = tempfile::tempdir()?;
    // There is nothing to judge without a policy; what it proposes is all one.
    let policy = folder.path().join("policy.onnx");
    let bytes = encode(&net(256, 0), &Provenance::default(), &[vec![0.5; 259]]);
    std::fs::write(&policy, bytes).with_context(|| policy.display().to_string())?;
    let conducts = conducts(&arguments.load);
    let bar = ProgressBar::new((conducts.len() * arguments.rate.len()) as u64);
    let mut rows = Vec::new();
    for &rate_hz in &arguments.rate {
        for &conduct in &conducts {
            bar.set_message(conduct.words());
            rows.push(drive(arguments, (rate_hz, conduct), &policy, clock)?);
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    let measured = Measured {
        rows,
        seconds: arguments.seconds,
        conditions,
    };
    print(&measured);
    match &arguments.json {
        Some(path) => write_json(path, &measured),
        None => Ok(()),
    }
}

/// The rows of one rate; without a judge first, and last once more.
fn conducts(loads: &[Load]) -> Vec<Conduct> {
    let mut conducts = vec![Conduct::Absent];
    if loads.contains(&Load::Gate) {
        conducts.extend(Conduct::BAD);
        conducts.push(Conduct::Absent);
    }
    conducts
}

fn drive(
    arguments: &BenchLatency,
    (rate_hz, conduct): (f64, Conduct),
    policy: &std::path::Path,
    clock: Clock,
) -> anyhow::Result<Row> {
    let judge = conduct.begin()?;
    let mut up = vec!["--seed".into(), "3".into(), "--policy".into()];
    up.push(policy.display().to_string());
    up.extend(["--rate".into(), rate_hz.to_string()]);
    up.extend(["--duration".into(), arguments.seconds.to_string()]);
    up.extend(judge.arguments());
    for text in &arguments.overrides {
        up.extend(["--set".into(), text.clone()]);
    }
    let floor = Floor::start(rate_hz, clock)?;
    let driven = Driven::start("latency", up)?;
    let judge = judge.conduct(arguments.seconds);
    let summary = driven.finish()?;
    Ok(Row {
        rate_hz,
        beside: conduct.words().into(),
        questions: judge.questions(),
        world: Punctuality::of(&summary, "world"),
        controller: Punctuality::of(&summary, "controller"),
        floor: floor.finish()?,
    })
}

fn print(measured: &Measured) {
    let mut table = table(&[
        "",
        "questions",
        "ticks",
        "missed",
        "late p50 us",
        "p99",
        "max",
        "tick p50 us",
        "p99",
        "max",
        "world late p99",
        "max",
        "floor missed",
        "late p99",
        "max",
    ]);
    for row in &measured.rows {
        let (late, tick) = (row.controller.lateness_us, row.controller.execution_us);
        let world = row.world.lateness_us;
        let mut cells = vec![
            format!("{} Hz, {}", row.rate_hz, row.beside),
            row.questions.to_string(),
            row.controller.ticks.to_string(),
            (row.controller.missed + row.world.missed).to_string(),
        ];
        let times = [
            late.p50, late.p99, late.max, tick.p50, tick.p99, tick.max, world.p99, world.max,
        ];
        cells.extend(times.map(|us| format!("{us:.0}")));
        cells.push(row.floor.missed.to_string());
        let floor = row.floor.lateness_us;
        cells.extend([floor.p99, floor.max].map(|us| format!("{us:.0}")));
        table.add_row(cells);
    }
    say(table);
    let first = measured.rows.first();
    let priority = first.map_or("unknown", |row| &row.controller.priority);
    say(format_args!(
        "controller and world, whole process set, {} s each, real-time priority {priority}, {}; \
         floor: a thread that only wakes up, at the same rate and priority in the same seconds; \
         nothing is left out of a maximum",
        measured.seconds, measured.conditions
    ));
}
