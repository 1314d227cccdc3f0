//! `bench swap`: does a running set notice that its weights are swapped?

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context, bail};
use hdrhistogram::Histogram;
use policy::{Provenance, encode};
use serde::Serialize;
use shm_config::run::RunPaths;
use shm_config::services::Process;
use shm_config::wire::Wire;
use supervisor::swap::{Answer, Offers};

use crate::Clock;
use crate::arguments::BenchSwap;
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
    /// Ticks of the controller.
    pub ticks: u64,
    /// Ticks of the controller missed: skipped, or done after their deadline.
    pub missed: u64,
    /// Begin of the controller's tick after its instant, 99 % at most, us.
    pub lateness_p99_us: f64,
    /// The latest, us.
    pub lateness_max_us: f64,
    /// From offering to knowing that it is adopted, median, ms.
    pub adopted_after_p50_ms: Option<f64>,
    /// The longest, ms.
    pub adopted_after_max_ms: Option<f64>,
    /// What the kernel granted the controller: real-time priority.
    pub priority: String,
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

/// A set that is killed should anything here fail.
struct Driven(Child);

impl Drop for Driven {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn drive(
    arguments: &BenchSwap,
    rate_hz: f64,
    every_ns: Option<u64>,
    clock: Clock,
) -> anyhow::Result<Row> {
    let folder = tempfile::tempdir()?;
    let name = format!("swap-{}", std::process::id());
    let json = folder.path().join("up.json");
    let supervisor = std::env::current_exe()?.with_file_name("vlaps-supervisor");
    let mut command = Command::new(&supervisor);
    command
        .args(["up", "--run", &name, "--gate", "expert", "--seed", "3"])
        .args(["--rate", &rate_hz.to_string()])
        .args(["--duration", &arguments.seconds.to_string()])
        // Whatever the nets propose, they are charged at once and stay.
        .args(["--set", "policy.probation_ticks=0", "--set"])
        .args(["policy.veto_rate_max=1.0", "--set", "policy.jump_max=2.0"])
        .args(["--parent", &std::process::id().to_string()])
        .arg("--json")
        .arg(&json)
        .current_dir(folder.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null());
    for text in &arguments.overrides {
        command.args(["--set", text]);
    }
    let child = command
        .spawn()
        .with_context(|| supervisor.display().to_string())?;
    let mut driven = Driven(child);
    let mut row = Row {
        rate_hz,
        ..Row::default()
    };
    if let Some(every_ns) = every_ns {
        offer(&name, &mut row, (arguments.seconds, every_ns), clock)?;
    }
    if !driven.0.wait()?.success() {
        bail!("run '{name}' failed; its errors are above");
    }
    read(&json, &mut row)?;
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

fn read(json: &Path, row: &mut Row) -> anyhow::Result<()> {
    let json: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(json)?)?;
    let controller = &json["processes"]["controller"];
    let count = |key: &str| controller[key].as_u64().unwrap_or(0);
    let late_us = |key: &str| controller["release_lateness_us"][key].as_f64();
    row.ticks = count("ticks");
    row.missed = count("skipped") + count("late");
    row.lateness_p99_us = late_us("p99").unwrap_or(f64::NAN);
    row.lateness_max_us = late_us("max").unwrap_or(f64::NAN);
    let priority = controller["realtime"]["priority"].as_str();
    row.priority = priority.unwrap_or("unknown").into();
    Ok(())
}

fn print(swapped: &Swapped) {
    let mut table = table(&[
        "",
        "ticks",
        "missed",
        "late p99 us",
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
            row.ticks.to_string(),
            row.missed.to_string(),
            format!("{:.1}", row.lateness_p99_us),
            format!("{:.1}", row.lateness_max_us),
            format!("{} of {}", row.adopted, row.offered),
            number(row.adopted_after_p50_ms),
            number(row.adopted_after_max_ms),
        ]);
    }
    say(table);
    let priority = swapped.rows.first().map_or("unknown", |row| &row.priority);
    say(format_args!(
        "259-256-256-2, {} s each, whole process set, real-time priority {priority}, {}",
        swapped.seconds, swapped.conditions
    ));
}
