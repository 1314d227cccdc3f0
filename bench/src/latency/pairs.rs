//! Pairs of rows, one without load and one with it, alternating: their ratio cancels what
//! the machine does slowly.

use super::arguments::{Case, Load};
use super::row::Row;
use crate::driven::Quantiles;
use lab::report::table;
use serde::Serialize;
use supervisor::subcommand::say;

/// Quantiles 0.975 of Student's t by degrees of freedom from 1 on; later ones are taken
/// from the last.
const T_975: [f64; 9] = [12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26];

/// A ratio of rows with a load to rows without: the geometric mean over the pairs, and the
/// interval of 95 %, by Student's t of the logarithms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Ratio {
    /// The mean.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Ratio {
    /// `None` with fewer than two pairs.
    fn of(pairs: &[(f64, f64)]) -> Option<Self> {
        let logs: Vec<f64> = pairs
            .iter()
            .map(|(with, none)| (with / none).ln())
            .collect();
        let count = logs.len() as f64;
        let t = T_975.get(logs.len().checked_sub(2)?.min(T_975.len() - 1))?;
        let mean = logs.iter().sum::<f64>() / count;
        let square = |log: &f64| (log - mean) * (log - mean);
        let variance = logs.iter().map(square).sum::<f64>() / (count - 1.0);
        let half = t * (variance / count).sqrt();
        Some(Self {
            mean: mean.exp(),
            low: (mean - half).exp(),
            high: (mean + half).exp(),
        })
    }
}

/// What a load does to the rows of one rate and priority.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Paired {
    /// Rate, load and priority.
    pub name: String,
    /// Pairs.
    pub pairs: usize,
    /// Median response with the load over that without.
    pub response_p50: Option<Ratio>,
    /// The controller's lateness, 99.9 %, likewise.
    pub lateness_p999: Option<Ratio>,
    /// The controller's wake-up, 99.9 %, likewise.
    pub wake_up_p999: Option<Ratio>,
    /// The controller's lateness with the load, 99.9 %, over the floor's of the same row.
    pub lateness_to_floor: Option<Ratio>,
    /// The controller's wake-up with the load, 99.9 %, over the floor's of the same row.
    pub wake_up_to_floor: Option<Ratio>,
    /// Ticks missed in all rows with the load.
    pub missed_with: u64,
    /// Ticks missed in all rows without.
    pub missed_without: u64,
}

/// The pairs among the rows, in the order of the cases; none without `--pairs`.
pub fn of(cases: &[Case], rows: &[Row]) -> Vec<Paired> {
    let all: Vec<(&Case, &Row)> = cases.iter().zip(rows).collect();
    let mut paired = Vec::new();
    for (first, _) in all.iter().filter(|(case, _)| case.pair == Some(0)) {
        if first.beside == Load::NOTHING {
            continue;
        }
        let is_like =
            |case: &Case| (case.rate_hz, case.priority) == (first.rate_hz, first.priority);
        let with = all
            .iter()
            .filter(|(case, _)| is_like(case) && case.beside == first.beside);
        let pairs: Vec<(&Row, &Row)> = with
            .filter_map(|(case, with)| {
                let none = all.iter().find(|(other, _)| {
                    is_like(other) && other.beside == Load::NOTHING && other.pair == case.pair
                });
                Some((*with, none?.1))
            })
            .collect();
        paired.push(compared(&pairs, first.words_without_pair()));
    }
    paired
}

fn compared(pairs: &[(&Row, &Row)], name: String) -> Paired {
    let p50 = |us: Option<Quantiles>| us.map(|us| us.p50);
    let p999 = |us: Option<Quantiles>| us.map(|us| us.p999);
    let ratio = |of: &dyn Fn(&Row) -> Option<f64>| {
        let both = pairs
            .iter()
            .map(|(with, none)| Some((of(with)?, of(none)?)));
        Ratio::of(&both.collect::<Option<Vec<_>>>()?)
    };
    let to_floor = |of: &dyn Fn(&Row) -> Option<f64>| {
        let floor = |row: &Row| p999(row.floor.lateness_us);
        let both = pairs
            .iter()
            .map(|(with, _)| Some((of(with)?, floor(with)?)));
        Ratio::of(&both.collect::<Option<Vec<_>>>()?)
    };
    let lateness = |row: &Row| p999(row.controller.lateness_us);
    let wake_up = |row: &Row| p999(row.controller.wake_up_us);
    let missed = |row: &Row| row.world.missed + row.planner.missed + row.controller.missed;
    Paired {
        name,
        pairs: pairs.len(),
        response_p50: ratio(&|row| p50(row.response_us)),
        lateness_p999: ratio(&lateness),
        wake_up_p999: ratio(&wake_up),
        lateness_to_floor: to_floor(&lateness),
        wake_up_to_floor: to_floor(&wake_up),
        missed_with: pairs.iter().map(|(with, _)| missed(with)).sum(),
        missed_without: pairs.iter().map(|(_, none)| missed(none)).sum(),
    }
}

/// Prints the comparison; nothing without pairs.
pub fn print(paired: &[Paired]) {
    if paired.is_empty() {
        return;
    }
    say("\nwith the load over without, alternating: mean ratio (interval of 95 %)");
    let mut table = table(&[
        "",
        "pairs",
        "response p50",
        "lateness p99.9",
        "wake-up p99.9",
        "lateness / floor",
        "wake-up / floor",
        "missed with, without",
    ]);
    let cell = |ratio: Option<Ratio>| match ratio {
        Some(Ratio { mean, low, high }) => format!("{mean:.3} ({low:.2} to {high:.2})"),
        None => "-".into(),
    };
    for one in paired {
        table.add_row(vec![
            one.name.clone(),
            one.pairs.to_string(),
            cell(one.response_p50),
            cell(one.lateness_p999),
            cell(one.wake_up_p999),
            cell(one.lateness_to_floor),
            cell(one.wake_up_to_floor),
            format!("{}, {}", one.missed_with, one.missed_without),
        ]);
    }
    say(table);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latency::row::tests::row;

    #[test]
    fn a_ratio_has_its_interval() {
        assert_eq!(Ratio::of(&[(2.0, 1.0)]), None);
        let same = Ratio::of(&[(2.0, 1.0), (4.0, 2.0)]).expect("two pairs");
        assert!((same.mean - 2.0).abs() < 1e-12 && (same.high - same.low).abs() < 1e-9);
        let apart = Ratio::of(&[(1.0, 1.0), (4.0, 1.0)]).expect("two pairs");
        assert!((apart.mean - 2.0).abs() < 1e-12);
        assert!(apart.low < 1.0 && apart.high > 4.0, "{apart:?}");
    }

    #[test]
    fn rows_are_compared_with_those_of_their_pair() {
        let case = |load: Load, pair: u32| Case {
            rate_hz: 100.0,
            priority: crate::floor::Priority::Asked,
            beside: load.rows()[0],
            pair: Some(pair),
        };
        let cases = [
            case(Load::None, 0),
            case(Load::View, 0),
            case(Load::None, 1),
            case(Load::View, 1),
        ];
        let response = |us: f64| {
            let mut row = row();
            let quantiles = row.response_us.as_mut().expect("a response");
            quantiles.p50 = us;
            row
        };
        let rows = [100.0, 110.0, 200.0, 220.0].map(response);
        let paired = of(&cases, &rows);
        assert_eq!(paired.len(), 1, "{paired:?}");
        let ratio = paired[0].response_p50.expect("two pairs");
        assert!((ratio.mean - 1.1).abs() < 1e-9, "{paired:?}");
        assert_eq!((paired[0].pairs, paired[0].missed_with), (2, 12));
        let unpaired = cases.map(|case| Case { pair: None, ..case });
        assert_eq!(of(&unpaired, &rows), []);
    }
}
