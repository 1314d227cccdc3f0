//! Shares with confidence intervals, calibration, and Cohen's kappa.

/// The two-sided 95 % quantile of the normal distribution.
const Z: f64 = 1.959_963_984_540_054;

/// Number of hits among trials.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Share {
    /// Number of hits.
    pub hits: usize,
    /// Number of trials.
    pub trials: usize,
}

impl Share {
    /// Counts the trials that are true.
    pub fn of(trials: impl IntoIterator<Item = bool>) -> Self {
        let mut share = Self::default();
        for hit in trials {
            share.hits += usize::from(hit);
            share.trials += 1;
        }
        share
    }

    /// The share, [0, 1]; NaN without trials.
    pub fn mean(self) -> f64 {
        self.hits as f64 / self.trials as f64
    }

    /// Wilson's 95 % score interval. It lies within [0, 1] and holds at shares of 0 and 1,
    /// too; without trials it is [0, 1].
    pub fn interval(self) -> [f64; 2] {
        if self.trials == 0 {
            return [0.0, 1.0];
        }
        let (n, share) = (self.trials as f64, self.mean());
        let square = Z * Z / n;
        let middle = (share + square / 2.0) / (1.0 + square);
        let half = Z * (share * (1.0 - share) / n + square / (4.0 * n)).sqrt() / (1.0 + square);
        // Exact at the ends, where rounding would leave 1e-17.
        [
            if self.hits == 0 { 0.0 } else { middle - half },
            if self.hits == self.trials {
                1.0
            } else {
                middle + half
            },
        ]
    }
}

/// One bin of a reliability diagram: answers with about the same confidence.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize)]
pub struct Bin {
    /// Right answers among them.
    pub right: Share,
    /// Sum of their confidences.
    pub confidence_sum: f64,
}

impl Bin {
    /// Counts an answer with this confidence.
    pub fn count(&mut self, is_right: bool, confidence: f64) {
        self.right.trials += 1;
        self.right.hits += usize::from(is_right);
        self.confidence_sum += confidence;
    }
}

/// The expected calibration error: the mean distance of confidence and share of right
/// answers, weighted by the bins, [0, 1]. `None` without answers.
pub fn calibration_error(bins: &[Bin]) -> Option<f64> {
    let total: usize = bins.iter().map(|bin| bin.right.trials).sum();
    let off: f64 = bins
        .iter()
        .map(|bin| (bin.confidence_sum - bin.right.hits as f64).abs())
        .sum();
    (total > 0).then(|| off / total as f64)
}

/// Cohen's kappa of a square table of counts (rows: one judge, columns: the other): 1 if
/// they always agree, 0 if they agree as often as by chance. `None` if chance alone
/// agrees always, or the table is empty.
pub fn kappa<const N: usize>(counts: &[[usize; N]; N]) -> Option<f64> {
    let total: usize = counts.iter().flatten().sum();
    let n = total as f64;
    let agreed: usize = (0..N).map(|k| counts[k][k]).sum();
    let by_chance: f64 = (0..N)
        .map(|k| {
            let row: usize = counts[k].iter().sum();
            let column: usize = counts.iter().map(|row| row[k]).sum();
            (row as f64 / n) * (column as f64 / n)
        })
        .sum();
    let kappa = (agreed as f64 / n - by_chance) / (1.0 - by_chance);
    kappa.is_finite().then_some(kappa)
}

/// The quantile of sorted values; `None` without values.
pub fn quantile(values: &[f64], share: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let last = sorted.len().saturating_sub(1);
    sorted.get((last as f64 * share).round() as usize).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_matches_published_values() {
        // Newcombe 1998, table I: 81 of 263, and 0 of 20.
        let of = |hits, trials| Share { hits, trials }.interval();
        let [low, high] = of(81, 263);
        assert!((low - 0.2553).abs() < 5e-5 && (high - 0.3662).abs() < 5e-5);
        let [low, high] = of(0, 20);
        assert!(low == 0.0 && (high - 0.1611).abs() < 5e-5);
        assert_eq!(of(0, 0), [0.0, 1.0]);
    }

    #[test]
    fn kappa_matches_a_published_table() {
        // Cohen 1960 as worked in most textbooks: 20 and 15 agreed of 50.
        let kappa = kappa(&[[20, 5], [10, 15]]);
        assert!(kappa.is_some_and(|kappa| (kappa - 0.4).abs() < 1e-12));
    }

    #[test]
    fn kappa_of_one_answer_alone_is_none() {
        assert_eq!(kappa(&[[7, 0], [0, 0]]), None);
        assert_eq!(kappa(&[[0, 0], [0, 0]]), None);
    }

    #[test]
    fn the_calibration_error_is_weighted_by_the_bins() {
        let mut bins = [Bin::default(); 3];
        for is_right in [true, true, true, false] {
            bins[0].count(is_right, 0.75);
        }
        bins[2].count(false, 0.5);
        assert_eq!(calibration_error(&bins), Some(0.5 / 5.0));
        assert_eq!(calibration_error(&[]), None);
    }

    #[test]
    fn quantiles_are_of_the_sorted_values() {
        let values = [5.0, 1.0, 3.0, 2.0, 4.0];
        assert_eq!(quantile(&values, 0.5), Some(3.0));
        assert_eq!(quantile(&values, 1.0), Some(5.0));
        assert_eq!(quantile(&[], 0.5), None);
    }
}
