//! Means with 95 % confidence intervals, and the sign test.

use judge::statistics::Share;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::Serialize;
use statrs::distribution::{Binomial, ContinuousCDF, DiscreteCDF, StudentsT};

/// Number of bootstrap resamples: the ends of the interval then vary by about a fortieth of
/// its width between seeds.
const RESAMPLES: usize = 4000;
/// An arbitrary fixed seed, so that the same values give the same interval.
const BOOTSTRAP_SEED: u64 = 95;

/// A mean with its 95 % confidence interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// The mean.
    pub mean: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Estimate {
    /// A share with Wilson's score interval. It lies within [0, 1] and holds at shares of 0 and
    /// 1, too; without trials it is [0, 1].
    pub fn of_share(hits: usize, trials: usize) -> Estimate {
        let share = Share { hits, trials };
        let [low, high] = share.interval();
        Estimate {
            mean: share.mean(),
            low,
            high,
        }
    }

    /// A mean with the percentile interval of a bootstrap: completions cluster at 0.98, which
    /// is far from a normal distribution. A single value has no interval; without values the
    /// mean is NaN.
    pub fn of_mean(values: &[f64]) -> Estimate {
        let middle = mean(values);
        if values.len() < 2 {
            return Estimate {
                mean: middle,
                low: f64::NAN,
                high: f64::NAN,
            };
        }
        let mut stream = Xoshiro256PlusPlus::seed_from_u64(BOOTSTRAP_SEED);
        let count = values.len() as u128;
        // The upper half of the product is uniform within 1 in 2^64.
        let mut draw = || values[((u128::from(stream.next_u64()) * count) >> 64) as usize];
        let mut means: Vec<f64> = (0..RESAMPLES)
            .map(|_| (0..values.len()).map(|_| draw()).sum::<f64>() / values.len() as f64)
            .collect();
        means.sort_by(f64::total_cmp);
        Estimate {
            mean: middle,
            low: means[RESAMPLES / 40],
            high: means[RESAMPLES - 1 - RESAMPLES / 40],
        }
    }
}

/// As [`judge::statistics::quantile`]; NaN without values.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    judge::statistics::quantile(values, share).unwrap_or(f64::NAN)
}

/// The half width of the 95 % interval of the mean of independent values, by Student's
/// distribution; `None` with fewer than three values, for two give a factor of 12.7.
pub fn student_half(values: &[f64]) -> Option<f64> {
    let n = values.len() as f64;
    let freedom = StudentsT::new(0.0, 1.0, n - 1.0).ok();
    let freedom = freedom.filter(|_| values.len() > 2)?;
    Some(freedom.inverse_cdf(0.975) * (variance(values) / n).sqrt())
}

/// The mean of a table of values, and the half width of its 95 % interval if both its rows
/// and its columns are drawn at random: the variances of the two means, that of the rows by
/// [`student_half`], are added. What varies in the cells alone is counted in both, so the
/// interval is rather too wide. `None` with fewer than three rows or columns.
pub fn over_both(rows: &[Vec<f64>]) -> Option<(f64, f64)> {
    let columns = rows.iter().map(Vec::len).min()?;
    let of_rows: Vec<f64> = rows.iter().map(|row| mean(row)).collect();
    let of_columns: Vec<f64> = (0..columns)
        .map(|column| mean(&rows.iter().map(|row| row[column]).collect::<Vec<_>>()))
        .collect();
    let half = student_half(&of_rows)?.hypot(student_half(&of_columns)?);
    Some((mean(&of_rows), half))
}

/// The two-sided p value of the exact sign test: the probability of a split at least as uneven
/// if both sides are equally likely. 1 without trials.
pub fn sign_test(one: u64, other: u64) -> f64 {
    let fair = Binomial::new(0.5, one + other).ok();
    fair.map_or(1.0, |fair| (2.0 * fair.cdf(one.min(other))).min(1.0))
}

/// The mean; NaN without values.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The unbiased estimate of the variance.
fn variance(values: &[f64]) -> f64 {
    let middle = mean(values);
    let squares = values.iter().map(|value| (value - middle).powi(2));
    squares.sum::<f64>() / (values.len() as f64 - 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bootstrap_is_near_the_normal_interval_of_many_values() {
        let values: Vec<f64> = (0..1000).map(|k| f64::from(k) / 999.0).collect();
        let found = Estimate::of_mean(&values);
        // A uniform variable has deviation 1/sqrt(12).
        let half = 1.96 / 12f64.sqrt() / 1000f64.sqrt();
        assert!((found.low - (0.5 - half)).abs() < 0.1 * half, "{found:?}");
        assert!((found.high - (0.5 + half)).abs() < 0.1 * half, "{found:?}");
        assert_eq!(found, Estimate::of_mean(&values), "the same each time");
    }

    #[test]
    fn one_value_has_no_interval() {
        let one = Estimate::of_mean(&[3.0]);
        assert!(one.mean == 3.0 && one.low.is_nan() && one.high.is_nan());
    }

    #[test]
    fn sign_test_is_that_of_a_table() {
        // Conover, Practical Nonparametric Statistics: binomial distribution, p = 0.5.
        for (one, other, p) in [(0, 0, 1.0), (0, 5, 0.0625), (2, 8, 0.109_375), (4, 4, 1.0)] {
            assert!((sign_test(one, other) - p).abs() < 1e-9, "{one} {other}");
            assert_eq!(sign_test(one, other), sign_test(other, one));
        }
        // 10,000 fair trials have deviation 50: 5,100 are two of them above the middle.
        assert!(
            (sign_test(5100, 4900) - 0.0466).abs() < 1e-3,
            "{}",
            sign_test(5100, 4900)
        );
    }

    #[test]
    fn student_intervals_are_those_of_a_table() {
        assert_eq!(student_half(&[1.0, 2.0]), None);
        // Deviation 1, four degrees of freedom: 2.776.
        let values = [-1.264_911, -0.632_456, 0.0, 0.632_456, 1.264_911];
        let half = student_half(&values).expect("five values") * 5f64.sqrt();
        assert!((half - 2.776).abs() < 1e-3, "{half}");
        // 999 degrees of freedom: 1.962.
        let many: Vec<f64> = (0..1000).map(|k| f64::from(k % 2)).collect();
        let half = student_half(&many).expect("values") / (0.25f64 / 999.0).sqrt();
        assert!((half - 1.962).abs() < 1e-3, "{half}");
    }
}
