//! Means with 95 % confidence intervals.

use judge::statistics::Share;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::Serialize;

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
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        if values.len() < 2 {
            return Estimate {
                mean,
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
            mean,
            low: means[RESAMPLES / 40],
            high: means[RESAMPLES - 1 - RESAMPLES / 40],
        }
    }
}

/// As [`judge::statistics::quantile`]; NaN without values.
pub fn quantile(values: &[f64], share: f64) -> f64 {
    judge::statistics::quantile(values, share).unwrap_or(f64::NAN)
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
}
