//! `bench swap`: measures whether swapping weights delays the ticks of a running set.

use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use supervisor::subcommand::{Output, Subcommand, seconds};

use anyhow::bail;
use hdrhistogram::Histogram;
use policy::{Provenance, encode};
use serde::Serialize;
use shm_config::run::RunPaths;
use shm_config::services::Process;
use shm_config::wire::Wire;
use supervisor::cli::failure::Failure;
use supervisor::commands::swap::offers::{Answer, Offers};

use crate::driven::{Driven, Punctuality};
use crate::floor::{Floor, Priority};
use crate::inference::net;
use lab::report::{Machine, table};
use stack::Clock;
use supervisor::subcommand::{say, write_json_option};

/// Measure whether swapping weights delays the ticks of a running set.
#[derive(Debug, Args)]
#[command(
    after_help = "At each rate the whole set drives twice: without swaps, and with new weights every \
        second.\n\n\
        Examples:\n  \
        ./vlaps bench swap\n  \
        ./vlaps bench swap --seconds 300 --rate 10,100 --json swap.json"
)]
pub struct BenchSwap {
    /// Seconds per row, 5 at least: there are no swaps in the first and the last two
    /// seconds.
    #[arg(long, value_name = "S", default_value_t = 30.0, allow_negative_numbers = true,
          value_parser = seconds)]
    pub seconds: f64,
    /// Tick rates, one or more.
    #[arg(
        long,
        value_name = "HZ",
        allow_negative_numbers = true,
        value_delimiter = ',',
        default_value = "10,100"
    )]
    pub rate: Vec<f64>,
    /// Override any key of the configuration, such as planner.rate_hz=10; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Also write the rows to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for BenchSwap {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        if offers(self.seconds) == 0 {
            return Err(Failure::Usage(format!(
                "--seconds {}: too short for a swap; at least {}",
                self.seconds,
                2.0 * MARGIN_S + EVERY_S
            ))
            .into());
        }
        let conditions = Machine::here()?;
        let mut rows = Vec::new();
        for &rate_hz in &self.rate {
            for every_s in [None, Some(EVERY_S)] {
                let row = Row {
                    rate_hz,
                    every_s,
                    ..Row::default()
                };
                rows.push(drive(self, row, clock)?);
            }
        }
        let results = SwapResults {
            rows,
            seconds: self.seconds,
            conditions,
        };
        print(&results);
        write_json_option(&self.json, &results)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Interval between two offers of weights, s.
const EVERY_S: f64 = 1.0;
/// Time limit for the set to start, ns.
const START_NS: u64 = 20_000_000_000;
/// Time limit for the answer to an offer, ns.
const ANSWER_NS: u64 = 5_000_000_000;
/// Time before the first offer and after the last, s.
const MARGIN_S: f64 = 2.0;
const LOOK: Duration = Duration::from_millis(2);

/// One run of the set.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Row {
    /// Requested tick rate, Hz.
    pub rate_hz: f64,
    /// Interval between two offers, s; `None` without swaps.
    pub every_s: Option<f64>,
    /// Weights offered.
    pub offered: u64,
    /// Of those, adopted.
    pub adopted: u64,
    /// From an offer to the report that it is adopted, median, ms.
    pub adopted_after_p50_ms: Option<f64>,
    /// The same, maximum, ms.
    pub adopted_after_max_ms: Option<f64>,
    /// Punctuality of the controller.
    pub controller: Punctuality,
    /// Punctuality of a thread that only wakes up, at the same rate and priority.
    pub floor: Punctuality,
}

impl Row {
    /// Names the row by the requested swaps, whether or not they were adopted.
    fn name(&self) -> String {
        match self.every_s {
            None => format!("{} Hz, no swaps", self.rate_hz),
            Some(_) => format!("{} Hz, a swap a second", self.rate_hz),
        }
    }
}

/// All rows.
#[derive(Clone, Debug, Serialize)]
pub struct SwapResults {
    /// For each rate, a row without and a row with swaps.
    pub rows: Vec<Row>,
    /// Seconds driven per row.
    pub seconds: f64,
    /// The machine.
    pub conditions: Machine,
}

/// Number of offers in a row of `seconds`.
fn offers(seconds: f64) -> u64 {
    ((seconds - 2.0 * MARGIN_S).max(0.0) / EVERY_S) as u64
}

/// Drives a row and fills in its results.
fn drive(arguments: &BenchSwap, mut row: Row, clock: Clock) -> anyhow::Result<Row> {
    let rate_hz = row.rate_hz;
    let mut up: Vec<String> = ["--gate", "expert", "--seed", "3", "--rate"]
        .map(String::from)
        .to_vec();
    up.extend([rate_hz.to_string(), "--duration".into()]);
    up.push(arguments.seconds.to_string());
    let stay = [
        // The networks become active at once and stay active, whichever actions they propose.
        "policy.shadow_ticks=0",
        "policy.veto_rate_max=1.0",
        "policy.jump_max=2.0",
    ];
    for text in stay.map(String::from).iter().chain(&arguments.overrides) {
        up.extend(["--set".into(), text.clone()]);
    }
    let floor = Floor::start(rate_hz, Priority::Asked, clock)?;
    let driven = Driven::start("swap", up)?;
    if row.every_s.is_some() {
        offer(driven.name(), &mut row, offers(arguments.seconds), clock)?;
    }
    row.controller = Punctuality::of(&driven.finish()?, "controller");
    row.floor = floor.finish()?.punctuality;
    Ok(row)
}

/// Offers new weights `count` times, on an absolute time grid.
fn offer(name: &str, row: &mut Row, count: u64, clock: Clock) -> anyhow::Result<()> {
    let name = name.parse()?;
    let paths = RunPaths::new(name);
    let until = clock().after_ns(START_NS);
    while paths.supervisor_pid().is_none() {
        if clock() > until {
            bail!("the set does not start");
        }
        supervisor::machine::signals::pause(LOOK);
    }
    let wire = Wire::join(paths.name(), Process::Learner)?;
    let mut offers = Offers::open(&wire)?;
    offers.next_version(clock);
    let begun = clock().after_ns((MARGIN_S * 1e9) as u64);
    let mut after_ms = Histogram::<u64>::new_with_bounds(1, 60_000_000, 3)?;
    for k in 0..count {
        let bytes = encode(&net(256, k), &Provenance::default(), &[vec![0.5; 259]]);
        let due = begun.after_ns((k as f64 * EVERY_S * 1e9) as u64);
        while clock() < due {
            supervisor::machine::signals::pause(LOOK);
        }
        let version = offers.next_version(clock);
        let published = clock();
        row.offered += u64::from(offers.offer(version, &bytes));
        match offers.answer(version, &bytes, clock, ANSWER_NS)? {
            Answer::Adopted { .. } | Answer::Ready { .. } => row.adopted += 1,
            Answer::Refused(reason) => bail!("refused: {reason}"),
            Answer::Overtaken(by) => bail!("replaced by version {by}"),
        }
        after_ms.saturating_record(clock().since_ns(published) / 1000);
    }
    row.adopted_after_p50_ms = Some(after_ms.value_at_quantile(0.5) as f64 / 1e3);
    row.adopted_after_max_ms = Some(after_ms.max() as f64 / 1e3);
    Ok(())
}

fn print(results: &SwapResults) {
    let mut table = table(&[
        "",
        "ticks",
        "missed",
        "late p99 us",
        "max us",
        "floor missed",
        "p99 us",
        "max us",
        "adopted",
        "after p50 ms",
        "max ms",
    ]);
    for row in &results.rows {
        let number = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.1}"));
        let adopted = match row.every_s {
            None => "-".into(),
            Some(_) => format!("{} of {}", row.adopted, row.offered),
        };
        table.add_row([
            row.name(),
            row.controller.ticks.to_string(),
            row.controller.missed.to_string(),
            number(row.controller.lateness_us.map(|us| us.p99)),
            number(row.controller.lateness_us.map(|us| us.max)),
            row.floor.missed.to_string(),
            number(row.floor.lateness_us.map(|us| us.p99)),
            number(row.floor.lateness_us.map(|us| us.max)),
            adopted,
            number(row.adopted_after_p50_ms),
            number(row.adopted_after_max_ms),
        ]);
    }
    say(table);
    let first = results.rows.first();
    let priority = first.map_or("unknown", |row| &row.controller.priority);
    say(format_args!(
        "259-256-256-2, {} s each, whole process set, real-time priority {priority}, {}; floor: a \
         thread that only wakes up, at the same rate and priority in the same seconds",
        results.seconds, results.conditions
    ));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_named_by_what_was_asked_for() {
        let row = |every_s| Row {
            rate_hz: 10.0,
            every_s,
            ..Row::default()
        };
        assert_eq!(row(None).name(), "10 Hz, no swaps");
        // No offer was made in it.
        assert_eq!(row(Some(1.0)).name(), "10 Hz, a swap a second");
    }

    #[test]
    fn offers_keep_away_from_both_ends() {
        assert_eq!([4.0, 4.9, 5.0, 30.0].map(offers), [0, 0, 1, 26]);
    }
}
