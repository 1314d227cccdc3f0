//! Process sets beside each other on this machine.

use std::time::Duration;

use anyhow::bail;
use serde_json::Value;
use shm_config::counted;
use supervisor::machine::signals::pause;

use super::rows::Row;
use super::sweep::{Bench, Cost, Late};
use crate::driven::{Driven, Punctuality, quantiles};
use crate::floor::{Floor, Priority};

/// Processes whose ticks must be in time.
const PUNCTUAL: [&str; 3] = ["world", "planner", "controller"];
/// Interval of the checks whether the sets have ended.
const LOOK: Duration = Duration::from_millis(50);

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
/// period beside them. The cost is the 99 % quantile of each controller's response.
///
/// # Errors
/// If a set fails.
pub fn measure(value: u64, rate_hz: f64, bench: &Bench) -> anyhow::Result<Option<Cost>> {
    let (rate, seconds) = (rate_hz.to_string(), bench.seconds.to_string());
    let floor = Floor::start(rate_hz, Priority::Asked, bench.gauges.clock())?;
    let mut sets = Vec::new();
    for k in 0..value {
        let up = ["--seed", "3", "--rate", &rate, "--duration", &seconds];
        sets.push(Driven::start(&format!("sc{k}"), up)?);
    }
    let mut is_stopping = false;
    while !ended(&mut sets)? {
        if bench.stop.is_asked() && !is_stopping {
            // Only once: a second signal would kill the sets.
            sets.iter().for_each(Driven::stop);
            is_stopping = true;
        }
        pause(LOOK);
    }
    let floor = floor.finish()?.punctuality;
    if is_stopping {
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

fn ended(sets: &mut [Driven]) -> anyhow::Result<bool> {
    for set in sets {
        if !set.has_ended()? {
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
