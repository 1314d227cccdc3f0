//! `bench swap`: does a running set notice that its weights are swapped?

use std::time::Duration;

use anyhow::bail;
use hdrhistogram::Histogram;
use policy::{Provenance, encode};
use serde::Serialize;
use shm_config::run::RunPaths;
use shm_config::services::Process;
use shm_config::wire::Wire;
use supervisor::swap::{Answer, Offers};

use crate::Clock;
use crate::arguments::BenchSwap;
use crate::driven::{Driven, Punctuality};
use crate::floor::{Floor, Priority};
use crate::inference::net;
use crate::report::{Machine, say, table, write_json};

/// From offer to offer, ns.
const EVERY_NS: u64 = 1_000_000_000;
/// How long the set may take to start, ns.
const START_NS: u64 = 20_000_000_000;
/// How long an offer may take, ns.
const ANSWER_NS: u64 = 5_000_000_000;
/// Before the first offer and after the last, s.
const MARGIN_S: f64 = 2.0;
const LOOK: Duration = Duration::from_millis(2);

/// One run of the set.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Row {
    /// Ticks a second asked for.
    pub rate_hz: f64,
    /// Weights offered.
    pub offered: u64,
    /// Of those, adopted.
    pub adopted: u64,
    /// From offering to knowing that it is adopted, median, ms.
    pub adopted_after_p50_ms: Option<f64>,
    /// The longest, ms.
    pub adopted_after_max_ms: Option<f64>,
    /// The controller.
    pub controller: Punctuality,
    /// A thread beside it that only wakes up, at the same rate and priority.
    pub floor: Punctuality,
}

/// All rows.
#[derive(Clone, Debug, Serialize)]
pub struct Swapped {
    /// Without and with swaps, for each rate.
    pub rows: Vec<Row>,
    /// Seconds driven for each.
    pub seconds: f64,
    /// Where.
    pub conditions: Machine,
}

/// `./vlaps bench swap`.
///
/// # Errors
/// When a set does not start, or does not answer.
pub fn bench(arguments: &BenchSwap, clock: Clock) -> anyhow::Result<()> {
    let conditions = Machine::here()?;
    let mut rows = Vec::new();
    for &rate_hz in &arguments.rate {
        for swaps in [false, true] {
            rows.push(drive(arguments, rate_hz, swaps.then_some(EVERY_NS), clock)?);
        }
    }
    let swapped = Swapped {
        rows,
        seconds: arguments.seconds,
        conditions,
    };
    print(&swapped);
    match &arguments.json {
        Some(path) => write_json(path, &swapped),
        None => Ok(()),
    }
}

fn drive(
    arguments: &BenchSwap,
    rate_hz: f64,
    every_ns: Option<u64>,
    clock: Clock,
) -> anyhow::Result<Row> {
    let mut up: Vec<String> = ["--gate", "expert", "--seed", "3", "--rate"]
        .map(String::from)
        .to_vec();
    up.extend([rate_hz.to_string(), "--duration".into()]);
    up.push(arguments.seconds.to_string());
    let stay = [
        // Whatever the nets propose, they are charged at once and stay.
        "policy.probation_ticks=0",
        "policy.veto_rate_max=1.0",
        "policy.jump_max=2.0",
    ];
    for text in stay.map(String::from).iter().chain(&arguments.overrides) {
        up.extend(["--set".into(), text.clone()]);
    }
    let floor = Floor::start(rate_hz, Priority::Asked, clock)?;
    let driven = Driven::start("swap", up)?;
    let mut row = Row {
        rate_hz,
        ..Row::default()
    };
    if let Some(every_ns) = every_ns {
        offer(
            driven.name(),
            &mut row,
            (arguments.seconds, every_ns),
            clock,
        )?;
    }
    row.controller = Punctuality::of(&driven.finish()?, "controller");
    row.floor = floor.finish()?.punctuality;
    Ok(row)
}

/// New weights on an absolute grid until shortly before the run's end.
fn offer(
    name: &str,
    row: &mut Row,
    (seconds, every_ns): (f64, u64),
    clock: Clock,
) -> anyhow::Result<()> {
    let name = name.parse()?;
    let paths = RunPaths::new(name);
    let until = clock().after_ns(START_NS);
    while paths.supervisor_pid().is_none() {
        if clock() > until {
            bail!("the set does not start");
        }
        supervisor::signals::pause(LOOK);
    }
    let wire = Wire::join(paths.name(), Process::Learner)?;
    let mut offers = Offers::open(&wire)?;
    offers.next_version(clock);
    let begun = clock().after_ns((MARGIN_S * 1e9) as u64);
    let count = ((seconds - 2.0 * MARGIN_S).max(0.0) * 1e9 / every_ns as f64) as u64;
    let mut after_ms = Histogram::<u64>::new_with_bounds(1, 60_000_000, 3)?;
    for k in 0..count {
        let bytes = encode(&net(256, k), &Provenance::default(), &[vec![0.5; 259]]);
        let due = begun.after_ns(k * every_ns);
        while clock() < due {
            supervisor::signals::pause(LOOK);
        }
        let version = offers.next_version(clock);
        let published = clock();
        row.offered += u64::from(offers.offer(version, &bytes));
        match offers.answer(version, &bytes, clock, ANSWER_NS)? {
            Answer::Adopted { .. } | Answer::Ready { .. } => row.adopted += 1,
            Answer::Refused(reason) => bail!("refused: {reason}"),
            Answer::Overtaken(by) => bail!("overtaken by version {by}"),
        }
        after_ms.saturating_record(clock().since_ns(published) / 1000);
    }
    row.adopted_after_p50_ms = Some(after_ms.value_at_quantile(0.5) as f64 / 1e3);
    row.adopted_after_max_ms = Some(after_ms.max() as f64 / 1e3);
    Ok(())
}

fn print(swapped: &Swapped) {
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
    for row in &swapped.rows {
        let number = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.1}"));
        let swaps = match row.offered {
            0 => "no swaps",
            _ => "a swap a second",
        };
        table.add_row([
            format!("{} Hz, {swaps}", row.rate_hz),
            row.controller.ticks.to_string(),
            row.controller.missed.to_string(),
            number(row.controller.lateness_us.map(|us| us.p99)),
            number(row.controller.lateness_us.map(|us| us.max)),
            row.floor.missed.to_string(),
            number(row.floor.lateness_us.map(|us| us.p99)),
            number(row.floor.lateness_us.map(|us| us.max)),
            format!("{} of {}", row.adopted, row.offered),
            number(row.adopted_after_p50_ms),
            number(row.adopted_after_max_ms),
        ]);
    }
    say(table);
    let first = swapped.rows.first();
    let priority = first.map_or("unknown", |row| &row.controller.priority);
    say(format_args!(
        "259-256-256-2, {} s each, whole process set, real-time priority {priority}, {}; floor: a \
         thread that only wakes up, at the same rate and priority in the same seconds",
        swapped.seconds, swapped.conditions
    ));
}
