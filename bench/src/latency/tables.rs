//! Prints the rows.

use super::Measured;
use super::recording::Recorded;
use super::row::{FLOOR_RATIO_MAX, RESPONSE_MAX_US, Row, SAMPLES_FEW};
use super::watch::Beside;
use crate::driven::Quantiles;
use lab::report::table;
use supervisor::subcommand::say;

/// Maximum number of misses listed per row; the JSON has all of them.
const LISTED_MAX: usize = 5;
/// Explanations below the tables.
const READING: &str = "a set drives until it has stopped, so it has a few more ticks than seconds x \
    rate; weights counts a row's own policy and each of a learner's; beside cyclictest a thread of \
    this program measures the floor, too ('floor: own thread' in the plots, own_floor in the JSON), \
    to show that both agree";
/// The column names of [`four`].
const FOUR: [&str; 4] = ["p50", "p99", "p99.9", "max"];

/// Prints all tables; nothing if there are no rows.
pub fn print(measured: &Measured, seconds: f64) {
    let rows = &measured.rows;
    if rows.is_empty() {
        return;
    }
    say("release lateness, us: from the scheduled instant to the begin of the tick");
    say(lateness(rows));
    say("\nwake-up, us: from the event that released the tick to its begin");
    say(wake_ups(rows));
    say("\nduration of a tick, and response (from the observation's release to the command), us");
    say(times(rows));
    say("\nratio to the floor, and comparison with the bars");
    say(bars(rows));
    for row in rows {
        events(row);
    }
    conditions(measured, seconds);
    for priority in ["real-time", "ordinary"] {
        let of: Vec<&Row> = rows.iter().filter(|row| row.priority == priority).collect();
        if !of.is_empty() {
            say(format_args!("\n{priority} priority, as Markdown, us\n"));
            say(markdown(&of));
        }
    }
}

fn name(row: &Row) -> String {
    format!("{} Hz, {}, {}", row.rate_hz, row.beside, row.priority)
}

fn us(quantiles: &[f64]) -> impl Iterator<Item = String> + '_ {
    quantiles.iter().map(|us| format!("{us:.0}"))
}

/// Median, 99 %, 99.9 % and maximum; "-" if not measured.
fn four(all: Option<Quantiles>) -> [String; 4] {
    match all {
        Some(all) => [all.p50, all.p99, all.p999, all.max].map(|us| format!("{us:.0}")),
        None => [const { "-" }; 4].map(String::from),
    }
}

fn times_floor(ratio: Option<f64>) -> String {
    ratio.map_or("-".into(), |ratio| format!("{ratio:.2}"))
}

/// A table with one group of columns per name; the first column of a group has the name.
fn headed(groups: &[(&str, &[&str])]) -> comfy_table::Table {
    let mut columns = vec![String::new()];
    for (name, quantiles) in groups {
        columns.push(format!("{name} {}", quantiles[0]));
        columns.extend(quantiles[1..].iter().map(|&word| word.into()));
    }
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    table(&columns)
}

fn lateness(rows: &[Row]) -> comfy_table::Table {
    let processes = ["controller", "planner", "world", "floor"];
    let mut table = headed(&processes.map(|name| (name, &FOUR[..])));
    for row in rows {
        let mut cells = vec![name(row)];
        for process in [&row.controller, &row.planner, &row.world, &row.floor] {
            cells.extend(four(process.lateness_us));
        }
        table.add_row(cells);
    }
    table
}

/// The world has no columns here: a timer releases it, so its wake-up is its lateness.
fn wake_ups(rows: &[Row]) -> comfy_table::Table {
    let processes = ["controller", "planner", "floor"];
    let mut table = headed(&processes.map(|name| (name, &FOUR[..])));
    for row in rows {
        let mut cells = vec![name(row)];
        let waking = [row.controller.wake_up_us, row.planner.wake_up_us];
        for measured in [waking[0], waking[1], row.floor.lateness_us] {
            cells.extend(four(measured));
        }
        table.add_row(cells);
    }
    table
}

fn times(rows: &[Row]) -> comfy_table::Table {
    let three = ["p50", "p99", "max"];
    let mut table = headed(&[
        ("controller", &three),
        ("planner", &three),
        ("world", &three),
        ("response", &FOUR),
    ]);
    for row in rows {
        let mut cells = vec![name(row)];
        for process in [&row.controller, &row.planner, &row.world] {
            let [p50, p99, _, max] = four(process.execution_us);
            cells.extend([p50, p99, max]);
        }
        cells.extend(four(row.response_us));
        table.add_row(cells);
    }
    table
}

fn bars(rows: &[Row]) -> comfy_table::Table {
    let mut table = table(&[
        "",
        "ticks",
        "skipped",
        "late",
        "world missed",
        "plans",
        "missed",
        "floor ticks",
        "missed",
        "controller late / floor",
        "wake-up / floor",
        "planner late / floor",
        "wake-up / floor",
        "questions",
        "weights",
        "verdict",
    ]);
    for row in rows {
        table.add_row([
            name(row),
            row.controller.ticks.to_string(),
            row.controller.skipped.to_string(),
            row.controller.late.to_string(),
            row.world.missed.to_string(),
            row.planner.ticks.to_string(),
            row.planner.missed.to_string(),
            row.floor.ticks.to_string(),
            row.floor.missed.to_string(),
            times_floor(row.to_floor(row.controller.lateness_us)),
            times_floor(row.to_floor(row.controller.wake_up_us)),
            times_floor(row.to_floor(row.planner.lateness_us)),
            times_floor(row.to_floor(row.planner.wake_up_us)),
            row.questions.to_string(),
            row.weights.to_string(),
            row.verdict(),
        ]);
    }
    table
}

/// The table of `results/latency.md`: rows of one priority; first the floor, then the
/// processes in the order in which an observation passes through them.
fn markdown(rows: &[&Row]) -> String {
    let columns = [
        "ticks",
        "missed c, p, w",
        "floor missed",
        "floor p50",
        "p99.9",
        "max",
        "controller late p50",
        "p99",
        "p99.9",
        "max",
        "/ floor",
        "wake-up p50",
        "p99",
        "p99.9",
        "max",
        "/ floor",
        "planner late p99.9",
        "/ floor",
        "wake-up p99.9",
        "/ floor",
        "response p50",
        "p99",
        "max",
    ];
    let mut text = format!("| | {} |\n|---|", columns.join(" | "));
    text.push_str(&"---:|".repeat(columns.len()));
    for row in rows {
        let (controller, planner) = (&row.controller, &row.planner);
        let mut cells = vec![
            format!("{} Hz, {}", row.rate_hz, row.beside),
            controller.ticks.to_string(),
            format!(
                "{}, {}, {}",
                controller.missed, planner.missed, row.world.missed
            ),
            row.floor.missed.to_string(),
        ];
        let [p50, _, p999, max] = four(row.floor.lateness_us);
        cells.extend([p50, p999, max]);
        for measured in [controller.lateness_us, controller.wake_up_us] {
            cells.extend(four(measured));
            cells.push(times_floor(row.to_floor(measured)));
        }
        for measured in [planner.lateness_us, planner.wake_up_us] {
            let [_, _, p999, _] = four(measured);
            cells.extend([p999, times_floor(row.to_floor(measured))]);
        }
        let [p50, p99, _, max] = four(row.response_us);
        cells.extend([p50, p99, max]);
        text.push_str(&format!("\n| {} |", cells.join(" | ")));
    }
    text
}

fn line(beside: &Beside) -> String {
    let late = beside
        .late_us
        .map_or(String::new(), |us| format!(" {us:.0} us late,"));
    let missed = match beside.missed {
        0 => String::new(),
        missed => format!(" missed {missed},"),
    };
    format!(
        "  at {:.2} s {}{missed}{late} the machine stalled {:.0} us in that second",
        beside.at_s, beside.process, beside.stall_us
    )
}

fn events(row: &Row) {
    let stalls: Vec<String> = us(&row.stalls_us).collect();
    say(format_args!(
        "\n{}: longest stalls of the machine {} us",
        name(row),
        stalls.join(", ")
    ));
    if row.restarts > 0 {
        say(format_args!("  {} restarts of processes", row.restarts));
    }
    for line in row.recording.iter().flat_map(Recorded::lines) {
        say(format_args!("  {line}"));
    }
    for beside in row.misses.iter().take(LISTED_MAX).chain(row.latest.first()) {
        say(line(beside));
    }
    if row.misses.len() > LISTED_MAX {
        let more = row.misses.len() - LISTED_MAX;
        say(format_args!("  {more} more in the JSON"));
    }
}

fn conditions(measured: &Measured, seconds: f64) {
    let rows = &measured.rows;
    let Some(first) = rows.first() else {
        return;
    };
    let granted: std::collections::BTreeSet<String> = rows
        .iter()
        .map(|row| {
            format!(
                "{}: controller {}, floor {}, processors kept from sleeping {}",
                row.priority, row.controller.priority, row.floor.priority, row.cpu_latency
            )
        })
        .collect();
    let granted: Vec<String> = granted.into_iter().collect();
    say(format_args!(
        "\nwhole process set, {seconds} s a row, {}; rights ({}); load by {}; floor by {}, \
         same priority and period, same seconds; stalls by threads on each core, above the set's \
         priorities, that only wake up, 1,000 times a second; elapsed / period == ticks + skipped holds in every row; nothing is left out of a \
         maximum; skipped ticks are in lateness and wake-up, of the floor too, each from its own \
         instant to the begin of the tick after it",
        measured.conditions,
        granted.join("; "),
        first.settings.stress,
        first.floor_by,
    ));
    let plans: std::collections::BTreeSet<String> = rows
        .iter()
        .map(|row| format!("{} at {} Hz", row.plan_rate_hz, row.rate_hz))
        .collect();
    let plans: Vec<String> = plans.into_iter().collect();
    say(format_args!("plans a second: {}", plans.join(", ")));
    say(READING);
    say(format_args!(
        "bars: 99.9 % of lateness and of wake-up of controller and planner at most {FLOOR_RATIO_MAX} times the \
         floor's; 99 % of response under {} us beside nothing, {} us beside anything",
        RESPONSE_MAX_US[0], RESPONSE_MAX_US[1]
    ));
    if rows.iter().any(|row| row.controller.ticks < SAMPLES_FEW) {
        say(format_args!(
            "rows of less than {SAMPLES_FEW} ticks have few samples beyond 99.9 %: look at 1,000 Hz \
             for the tail"
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latency::row::tests::row;

    #[test]
    fn the_markdown_has_a_cell_for_each_column_and_a_dash_for_what_is_not_there() {
        let mut row = row();
        row.planner.wake_up_us = None;
        let text = markdown(&[&row]);
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split('|').collect()).collect();
        assert_eq!(lines.len(), 3);
        assert!(
            lines.iter().all(|cells| cells.len() == lines[0].len()),
            "{text}"
        );
        let cells: Vec<&str> = lines[2].iter().map(|cell| cell.trim()).collect();
        assert_eq!(cells[1..4], ["100 Hz, none", "1998", "2, 2, 2"]);
        // Controller: the 99.9 % lateness equals the floor's, the wake-up is two thirds of it.
        assert_eq!([cells[12], cells[17]], ["1.00", "0.67"]);
        assert_eq!(cells[20..22], ["-", "-"]);
    }
}
