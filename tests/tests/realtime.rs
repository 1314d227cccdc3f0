//! What a real set says of its own punctuality, memory and threads; and that what
//! is late or slow is counted, held back or braked, as configured. Nothing here
//! depends on how fast the machine is.

use std::collections::BTreeMap;
use std::fs;
use std::sync::{Mutex, PoisonError};

use serde_json::Value;
use vlaps_tests::Set;

/// Bars of resident memory, MB of 10^6 bytes.
const BARS_MB: [(&str, f64); 2] = [("controller", 64.0), ("planner", 32.0)];

/// Sets share a core where there are few, and a planner that never rests starves all
/// others of its priority: one set at a time.
static ALONE: Mutex<()> = Mutex::new(());

fn drive(set: &Set, more: &[&str]) -> Value {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let arguments = [&["--seed", "3", "--duration", "4"], more].concat();
    let output = set.run(&arguments);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    set.json()
}

fn number(json: &Value, key: &str) -> f64 {
    json[key]
        .as_f64()
        .unwrap_or_else(|| panic!("{key} in {json}"))
}

#[test]
fn a_set_accounts_for_its_time_memory_and_threads() {
    let set = Set::new("accounts");
    let json = drive(&set, &["--rate", "100"]);
    let processes = &json["processes"];
    assert_memory_and_threads(processes);
    assert_durations(processes);
    let first_s = number(&json, "first_command_s");
    assert!(first_s > 0.0 && first_s < 60.0, "{first_s}");
    assert_raw_counts(&raw_counts(&set), processes);
}

fn assert_memory_and_threads(processes: &Value) {
    for (process, bar_mb) in BARS_MB {
        let row = &processes[process];
        let resident_mb = number(row, "resident_mb");
        assert!(
            (1.0..bar_mb).contains(&resident_mb),
            "{process}: {resident_mb} MB, {}",
            row["memory_mb"]
        );
    }
    for process in ["world", "planner", "controller"] {
        let row = &processes[process];
        let instants = number(row, "elapsed_s") / number(row, "period_s");
        let counted = number(row, "ticks") + number(row, "skipped");
        assert_eq!(instants.round(), counted, "{process}: {row}");
        assert!(number(row, "ticks") > 0.0, "{row}");
        let threads = row["threads"].as_array().expect("threads");
        assert!(threads[0]["is_tick"] == true, "{row}");
        // No other thread has the privileges of the tick's thread.
        for helper in &threads[1..] {
            assert_eq!(helper["scheduling_got"], "ordinary", "{helper}");
            assert_eq!(helper["priority_got"], 0, "{helper}");
        }
    }
}

fn assert_durations(processes: &Value) {
    let controller = &processes["controller"];
    for measure in [
        "release_lateness",
        "wake_up",
        "execution",
        "response",
        "observation_age",
        "plan_age",
    ] {
        let quantiles = &controller[format!("{measure}_us")];
        let [p50, p99, p999, max] = ["p50", "p99", "p999", "max"].map(|key| number(quantiles, key));
        assert!(p50 > 0.0, "{measure}: {quantiles}");
        assert!(
            p50 <= p99 && p99 <= p999 && p999 <= max,
            "{measure}: {quantiles}"
        );
    }
    // A process is woken after the instant at which it was due.
    for process in ["planner", "controller"] {
        let row = &processes[process];
        let [wake_up, lateness] =
            ["wake_up_us", "release_lateness_us"].map(|key| number(&row[key], "p50"));
        assert!(wake_up < lateness, "{process}: {row}");
    }
    assert!(processes["world"]["response_us"].is_null());
}

fn assert_raw_counts(counts: &RawCounts, processes: &Value) {
    let count = |process: &str, measure: &str| {
        let key = (process.to_string(), measure.to_string());
        counts.get(&key).copied().unwrap_or(0) as f64
    };
    assert_eq!(
        count("controller", "execution"),
        number(&processes["controller"], "ticks")
    );
    assert_eq!(
        count("planner", "observation_age"),
        number(&processes["planner"], "ticks")
    );
    assert!(count("controller", "response") > 0.0);
    // Skipped ticks count as late.
    for process in ["world", "planner", "controller"] {
        let row = &processes[process];
        let instants = number(row, "ticks") + number(row, "skipped");
        for measure in ["release_lateness", "wake_up"] {
            assert_eq!(count(process, measure), instants, "{process}: {measure}");
        }
    }
}

/// Counts of durations, by process and measure.
type RawCounts = BTreeMap<(String, String), u64>;

/// The durations counted in `timing.csv`, by process and measure.
fn raw_counts(set: &Set) -> RawCounts {
    let folder = set.folder().join("runs").join(set.name().to_string());
    let text = fs::read_to_string(folder.join("timing.csv")).expect("timing.csv");
    let mut lines = text.lines();
    let head = lines.next();
    assert_eq!(head, Some("process,measure,from_ns,below_ns,count,max_ns"));
    let mut counts = BTreeMap::new();
    for line in lines {
        let cells: Vec<_> = line.split(',').collect();
        let [process, measure, from_ns, below_ns, count, max_ns] = cells[..] else {
            panic!("six columns: {line}");
        };
        let [from_ns, below_ns, count, max_ns]: [u64; 4] =
            [from_ns, below_ns, count, max_ns].map(|cell| cell.parse().expect("a number"));
        assert!(
            from_ns < below_ns && from_ns <= max_ns && count > 0,
            "{line}"
        );
        *counts.entry((process.into(), measure.into())).or_default() += count;
    }
    counts
}

/// A planner that never is in time: each search takes many periods.
const SLOW_PLANNER: [&str; 8] = [
    "--rate",
    "500",
    "--set",
    "planner.iterations=4000",
    "--set",
    "planner.shrink_after=4096",
    "--set",
    "limits.plan_age_ms=10000",
];

#[test]
fn a_slow_planner_is_named_and_late_plans_are_counted() {
    let set = Set::new("late-count");
    let json = drive(&set, &SLOW_PLANNER);
    let planner = &json["processes"]["planner"];
    assert!(number(&planner["overruns"], "search") > 0.0, "{planner}");
    assert_eq!(planner["late"], planner["ticks"], "{planner}");
    // What it skips while it searches is as late as it is, not left out.
    let [ticks, skipped] = ["ticks", "skipped"].map(|key| number(planner, key));
    assert!(skipped > 0.0, "{planner}");
    let lateness = ("planner".to_string(), "release_lateness".to_string());
    assert_eq!(raw_counts(&set)[&lateness] as f64, ticks + skipped);
    assert!(json["reasons"]["expert"].is_object(), "{}", json["reasons"]);
}

#[test]
fn late_plans_are_held_back_where_that_is_configured() {
    let set = Set::new("late-skip");
    let skip = ["--set", "deadlines.planner=\"skip\""];
    let json = drive(&set, &[&SLOW_PLANNER[..], &skip].concat());
    assert!(number(&json["processes"]["planner"], "ticks") > 0.0);
    let reasons = &json["reasons"];
    assert!(number(&reasons["brake"], "unplanned") > 0.0, "{reasons}");
    assert!(reasons["expert"].is_null(), "{reasons}");
}

#[test]
fn late_plans_brake_where_that_is_configured() {
    let set = Set::new("late-brake");
    let brake = ["--set", "deadlines.planner=\"brake\""];
    let json = drive(&set, &[&SLOW_PLANNER[..], &brake].concat());
    let reasons = &json["reasons"];
    assert!(number(&reasons["brake"], "blocked") > 0.0, "{reasons}");
    assert!(reasons["expert"].is_null(), "{reasons}");
}

#[test]
fn a_budget_too_small_for_any_tick_is_overrun_in_every_tick_by_its_part() {
    let set = Set::new("budgets");
    let json = drive(&set, &["--set", "deadlines.budget_scale=1e-6"]);
    let processes = &json["processes"];
    for (process, part) in [("controller", "decide"), ("world", "observe")] {
        let row = &processes[process];
        assert_eq!(row["overruns"][part], row["ticks"], "{process}: {row}");
    }
}
