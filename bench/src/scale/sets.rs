//! Process sets beside each other on this machine.

use std::time::Duration;

use anyhow::bail;
use serde_json::Value;
use shm_config::counted;
use shm_config::message::Message;
use stack::Clock;
use supervisor::machine::signals::pause;

use super::rows::Row;
use super::sweep::{Bench, Cost, Late};
use crate::driven::{Driven, Punctuality, START_NS, quantiles};
use crate::floor::{Floor, Priority};

/// Processes whose ticks must be in time.
const PUNCTUAL: [&str; 3] = ["world", "planner", "controller"];
/// Interval of the checks whether the sets drive, or have ended.
const LOOK: Duration = Duration::from_millis(50);
/// Time that a set may drive beyond the row's, s: until the last set has begun. The row stops
/// all sets before.
const ALLOWANCE_S: f64 = 600.0;

/// Numbers of sets: each half as many again, so that the last punctual one is found to a
/// third.
pub fn values(most: u64) -> Vec<u64> {
    let mut values = Vec::new();
    let mut next = 1;
    while next <= most {
        values.push(next);
        next = (next + 1).max(next * 3 / 2);
    }
    values
}

/// Drives so many sets at the same time, and an idle thread of the same priority and
/// period beside them. The row's seconds begin when the last set drives, and no set ends
/// before they are over. The cost is the 99 % quantile of each controller's response, from
/// its own begin on.
///
/// # Errors
/// If a set fails, or one has ended while another one did not drive yet.
pub fn measure(value: u64, rate_hz: f64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    let rate = rate_hz.to_string();
    let seconds = (bench.seconds + ALLOWANCE_S).to_string();
    let floor = Floor::start(rate_hz, Priority::Asked, bench.gauges.clock())?;
    let mut sets = Vec::new();
    for k in 0..value {
        let up = ["--seed", "3", "--rate", &rate, "--duration", &seconds];
        sets.push(Driven::start(&format!("sc{k}"), up)?);
    }
    let is_over = drive_together(&mut sets, bench)?;
    // Only once: a second signal would kill the sets.
    sets.iter().for_each(Driven::stop);
    while !all(&mut sets, Driven::has_ended)? {
        pause(LOOK);
    }
    let floor = floor.finish()?.punctuality;
    if !is_over {
        return Ok(None);
    }
    let mut late = Late {
        floor: floor.missed,
        ..Late::default()
    };
    let mut turns = Vec::new();
    for set in sets {
        let summary = set.finish()?;
        late.add(&summary);
        let response = quantiles(&summary["processes"]["controller"], "response_us");
        match response {
            Some(response) => turns.push(response.p99),
            None => bail!("a set answered no observation"),
        }
    }
    Ok(Some(Cost {
        work: value as f64,
        turns,
        late: Some(late),
    }))
}

/// Waits until each set drives, and then for the row's time; `false` after a stop request.
fn drive_together(sets: &mut [Driven], bench: &Bench) -> anyhow::Result<bool> {
    let clock = bench.gauges.clock();
    for set in &mut *sets {
        if !wait_for_begin(set, bench, clock)? {
            return Ok(false);
        }
    }
    let begun = clock();
    while (clock().since_ns(begun) as f64) < bench.seconds * 1e9 {
        if bench.stop.is_asked() {
            return Ok(false);
        }
        pause(LOOK);
    }
    match all(sets, |set| Ok(!set.has_ended()?))? {
        true => Ok(true),
        false => bail!(
            "a set ended before all of them had driven for {} s at the same time; its errors are \
             above, or the machine starts so many too slowly",
            bench.seconds
        ),
    }
}

/// Waits until the world of a set has published an instant; `false` after a stop request.
fn wait_for_begin(set: &mut Driven, bench: &Bench, clock: Clock) -> anyhow::Result<bool> {
    let (_wire, mut progress) = set.listen(clock)?;
    let until = clock().after_ns(START_NS);
    while progress.newest(Message::check).is_none() {
        if bench.stop.is_asked() {
            return Ok(false);
        }
        if set.has_ended()? || clock() > until {
            bail!("a set does not drive; its errors are above");
        }
        progress.update_connections();
        pause(LOOK);
    }
    Ok(true)
}

fn all(
    sets: &mut [Driven],
    mut is_so: impl FnMut(&mut Driven) -> anyhow::Result<bool>,
) -> anyhow::Result<bool> {
    for set in sets {
        if !is_so(set)? {
            return Ok(false);
        }
    }
    Ok(true)
}

impl Late {
    fn add(&mut self, summary: &Value) {
        for process in PUNCTUAL {
            self.sets += Punctuality::of(summary, process).missed;
        }
        self.ticks += Punctuality::of(summary, "controller").ticks;
    }
}

/// How many sets are punctual.
pub fn verdict(rows: &[Row]) -> String {
    let punctual = rows.iter().take_while(|row| !row.ends_sweep()).last();
    let most = punctual.map_or(0, |row| row.value);
    match rows.iter().find(|row| row.ends_sweep()) {
        Some(row) => format!(
            "{} beside each other without a late tick that the floor does not have; with {} the \
             first ones are late",
            counted(most, "set"),
            row.value
        ),
        None => format!(
            "{} beside each other, the most that were driven, without a late tick that the floor \
             does not have",
            counted(most, "set")
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::super::rows::Settings;
    use super::*;

    #[test]
    fn the_numbers_grow_by_half() {
        assert_eq!(values(20), [1, 2, 3, 4, 6, 9, 13, 19]);
        assert_eq!(values(1), [1]);
    }

    #[test]
    fn the_verdict_names_the_last_punctual_row() {
        let row = |value, sets, floor| {
            let cost = Cost {
                work: value as f64,
                turns: vec![100.0],
                late: Some(Late {
                    sets,
                    floor,
                    ticks: 10,
                }),
            };
            Row::new(value, &cost, &Settings::of(1.0))
        };
        let rows = [row(1, 0, 0), row(2, 3, 4), row(3, 5, 4)];
        let words = verdict(&rows);
        assert!(
            words.starts_with("2 sets") && words.contains("with 3 "),
            "{words}"
        );
        assert!(verdict(&rows[..2]).contains("the most that were driven"));
        assert!(verdict(&rows[2..]).starts_with("0 sets"));
    }
}
