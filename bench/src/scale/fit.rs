//! The power law through measured points.

use std::fmt;

use serde::Serialize;

/// Quantiles 0.975 of Student's t by degrees of freedom from 1 on; later ones are taken
/// from the last.
const T_975: [f64; 9] = [12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26];
/// Fewest points of a fit: with two every exponent fits.
const POINTS_MIN: usize = 3;
/// Points of the exponent at the largest work, where fixed costs weigh least.
const LAST: usize = 3;

/// `cost = factor * work^exponent`, by least squares of the logarithms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Fit {
    /// The exponent over all points.
    pub exponent: f64,
    /// Its interval of 95 % by Student's t.
    pub exponent_interval: [f64; 2],
    /// The cost of one unit of work on the line.
    pub factor: f64,
    /// The exponent over the last three points.
    pub last_exponent: f64,
}

impl Fit {
    /// Through points of work and cost; `None` with fewer than three usable ones.
    pub fn of(points: &[(f64, f64)]) -> Option<Fit> {
        let usable = points
            .iter()
            .filter(|(work, cost)| *work > 0.0 && *cost > 0.0);
        let logs: Vec<(f64, f64)> = usable.map(|(work, cost)| (work.ln(), cost.ln())).collect();
        if logs.len() < POINTS_MIN {
            return None;
        }
        let (slope, offset) = line(&logs)?;
        let (last, _) = line(&logs[logs.len() - LAST..])?;
        let half = half_width(&logs, (slope, offset));
        Some(Fit {
            exponent: slope,
            exponent_interval: [slope - half, slope + half],
            factor: offset.exp(),
            last_exponent: last,
        })
    }

    /// The cost on the line.
    pub fn at(&self, work: f64) -> f64 {
        self.factor * work.powf(self.exponent)
    }
}

impl fmt::Display for Fit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Fit {
            exponent,
            exponent_interval: [low, high],
            last_exponent,
            ..
        } = self;
        write!(
            f,
            "exponent {exponent:.2} ({low:.2} to {high:.2}), over the last three rows \
             {last_exponent:.2}"
        )
    }
}

/// Slope and offset; `None` if all points have the same work.
fn line(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (x, y) = (mean(|point| point.0), mean(|point| point.1));
    let across: f64 = points.iter().map(|point| (point.0 - x).powi(2)).sum();
    let both: f64 = points
        .iter()
        .map(|point| (point.0 - x) * (point.1 - y))
        .sum();
    (across > 0.0).then(|| (both / across, y - both / across * x))
}

fn half_width(points: &[(f64, f64)], (slope, offset): (f64, f64)) -> f64 {
    let count = points.len() as f64;
    let x = points.iter().map(|point| point.0).sum::<f64>() / count;
    let across: f64 = points.iter().map(|point| (point.0 - x).powi(2)).sum();
    let rest = points
        .iter()
        .map(|point| point.1 - offset - slope * point.0);
    let squares: f64 = rest.map(|rest| rest * rest).sum();
    let freedom = points.len() - 2;
    let t = T_975[freedom.min(T_975.len()) - 1];
    t * (squares / freedom as f64 / across).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found_again() {
        let works = [1.0, 2.0, 4.0, 8.0, 16.0];
        for exponent in [0.0, 0.5, 1.0, 1.7] {
            let points = works.map(|work: f64| (work, 3.0 * work.powf(exponent)));
            let fit = Fit::of(&points).expect("a fit");
            assert!((fit.exponent - exponent).abs() < 1e-9, "{fit:?}");
            assert!((fit.factor - 3.0).abs() < 1e-9, "{fit:?}");
            assert!((fit.at(8.0) - points[3].1).abs() < 1e-9, "{fit:?}");
        }
    }

    #[test]
    fn a_fixed_cost_lowers_the_exponent_least_at_the_end() {
        let points: Vec<(f64, f64)> = (0..8)
            .map(|k| f64::from(1 << k))
            .map(|work| (work, 20.0 + work))
            .collect();
        let fit = Fit::of(&points).expect("a fit");
        assert!(fit.exponent < 0.5 && fit.last_exponent > 0.6, "{fit:?}");
        let [low, high] = fit.exponent_interval;
        assert!(low < fit.exponent && fit.exponent < high);
    }

    #[test]
    fn too_few_or_useless_points_have_no_fit() {
        assert_eq!(Fit::of(&[(1.0, 1.0), (2.0, 2.0)]), None);
        assert_eq!(Fit::of(&[(1.0, 1.0); 5]), None);
        assert_eq!(Fit::of(&[(1.0, 1.0), (2.0, f64::NAN), (4.0, 0.0)]), None);
    }
}
