//! Durations in log-linear buckets: full range, nothing filtered.
//!
//! The geometry is that of an HDR histogram with two significant digits: 64 ns
//! wide up to 16 us, then 128 buckets to each doubling, up to 17 s; longer
//! durations land in the last bucket and keep their exact value as maximum.

use crate::message::Histogram;

/// Width of the finest bucket, as a power of two of nanoseconds.
pub const UNIT_SHIFT: u32 = 6;
/// Buckets per doubling, as a power of two.
pub const HALF_SHIFT: u32 = 7;
/// Buckets in all; the last doubling ends at 2^34 ns = 17 s.
pub const BUCKETS: usize = 22 << HALF_SHIFT;

const _: () = assert!(BUCKETS == 2816, "as the message declares");

fn bucket_of(ns: u64) -> usize {
    let units = ns >> UNIT_SHIFT;
    let doublings = (64 - (units >> (HALF_SHIFT + 1)).leading_zeros()) as u64;
    let bucket = (doublings << HALF_SHIFT) + (units >> doublings);
    (bucket as usize).min(BUCKETS - 1)
}

/// The smallest duration of a bucket, ns.
fn floor_of(bucket: usize) -> u64 {
    let bucket = bucket as u64;
    let doublings = (bucket >> HALF_SHIFT).saturating_sub(1);
    (bucket - (doublings << HALF_SHIFT)) << (doublings as u32 + UNIT_SHIFT)
}

impl Histogram {
    /// Counts one duration.
    pub fn record(&mut self, ns: u64) {
        let count = &mut self.buckets[bucket_of(ns)];
        *count = count.saturating_add(1);
        self.count += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    /// Counts `count` durations: `first_ns`, `first_ns + step_ns` and so on. These are
    /// the latenesses of consecutive instants that one late tick ends. The counts are
    /// exact, and the work is bounded by the number of buckets.
    pub fn record_series(&mut self, first_ns: u64, step_ns: u64, count: u64) {
        let (mut ns, mut left) = (first_ns, count);
        while left > 0 {
            let bucket = bucket_of(ns);
            let here = match bucket + 1 < BUCKETS {
                true => left.min((floor_of(bucket + 1) - 1 - ns) / step_ns.max(1) + 1),
                false => left,
            };
            let more = u32::try_from(here).unwrap_or(u32::MAX);
            self.buckets[bucket] = self.buckets[bucket].saturating_add(more);
            let longest_ns = ns.saturating_add((here - 1).saturating_mul(step_ns));
            self.max_ns = self.max_ns.max(longest_ns);
            ns = longest_ns.saturating_add(step_ns);
            left -= here;
        }
        self.count += count;
    }

    /// Adds the counts of another, such as of the process before its restart.
    pub fn merge(&mut self, other: &Self) {
        for (count, more) in self.buckets.iter_mut().zip(&other.buckets) {
            *count = count.saturating_add(*more);
        }
        self.count += other.count;
        self.max_ns = self.max_ns.max(other.max_ns);
    }

    /// The non-empty buckets: lower bound (included), upper bound (excluded), ns, and
    /// count. The last bucket holds all longer durations, so it ends with the maximum.
    pub fn filled(&self) -> impl Iterator<Item = (u64, u64, u32)> + '_ {
        let filled = self.buckets.iter().enumerate();
        filled
            .filter(|(_, count)| **count > 0)
            .map(|(bucket, &count)| {
                let below_ns = match bucket + 1 == BUCKETS {
                    true => self.max_ns.saturating_add(1),
                    false => floor_of(bucket + 1),
                };
                (floor_of(bucket), below_ns, count)
            })
    }

    /// The same counts in the library's type, for quantiles and plots.
    #[cfg(feature = "std")]
    pub fn to_hdr(&self) -> hdrhistogram::Histogram<u64> {
        let mut hdr = hdrhistogram::Histogram::<u64>::new_with_bounds(1 << UNIT_SHIFT, 1 << 35, 2)
            .unwrap_or_else(|_| unreachable!("the bounds are constants that a test makes"));
        for (bucket, &count) in self.buckets.iter().enumerate() {
            if count > 0 {
                hdr.saturating_record_n(floor_of(bucket), u64::from(count));
            }
        }
        hdr
    }

    /// The quantile in [0, 1] of the durations, ns, to two digits and never above the
    /// exact maximum; 0 when nothing was counted.
    #[cfg(feature = "std")]
    pub fn quantile_ns(&self, quantile: f64) -> u64 {
        self.to_hdr().value_at_quantile(quantile).min(self.max_ns)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_duration_falls_into_the_bucket_that_holds_it() {
        for exponent in 0..34 {
            for offset in [0, 1, 63, 64, 65] {
                let ns = (1u64 << exponent) + offset;
                let bucket = bucket_of(ns);
                if bucket + 1 < BUCKETS {
                    assert!(floor_of(bucket) <= ns && ns < floor_of(bucket + 1), "{ns}");
                }
            }
        }
    }

    #[test]
    fn quantiles_agree_with_a_sorted_list() {
        let mut histogram = Histogram::default();
        let mut all: Vec<u64> = (0..10_000u64)
            .map(|k| 1_000 + k * k * 37 % 90_000_000)
            .collect();
        all.iter().for_each(|&ns| histogram.record(ns));
        all.sort_unstable();
        for quantile in [0.5, 0.9, 0.99, 0.999] {
            let exact = all[(quantile * all.len() as f64) as usize] as f64;
            let ours = histogram.quantile_ns(quantile) as f64;
            assert!(
                (ours / exact - 1.0).abs() < 0.02,
                "{quantile}: {ours} against {exact}"
            );
        }
        assert_eq!(histogram.quantile_ns(1.0), all[all.len() - 1]);
        assert_eq!(histogram.count, 10_000);
    }

    #[test]
    fn a_series_counts_what_its_durations_count_one_by_one() {
        let cases = [
            (17_000, 1_000_000, 0),
            (17_000, 1_000_000, 1),
            (999_999, 1_000_000, 40_000),
            (0, 10, 5_000),
            (63, 64, 300),
            (5, 0, 7),
        ];
        for (first_ns, step_ns, count) in cases {
            let (mut series, mut singly) = (Histogram::default(), Histogram::default());
            series.record_series(first_ns, step_ns, count);
            (0..count).for_each(|k| singly.record(first_ns + k * step_ns));
            assert_eq!(series, singly, "{count} from {first_ns} by {step_ns}");
        }
        // These are too many to be counted one by one.
        let mut endless = Histogram::default();
        endless.record_series(1, u64::MAX / 2, u64::MAX / 4);
        assert_eq!((endless.max_ns, endless.count), (u64::MAX, u64::MAX / 4));
    }

    #[test]
    fn the_filled_buckets_hold_each_duration_once() {
        let mut histogram = Histogram::default();
        let durations = [0, 63, 64, 16_500, 1_000_000, 1_000_001, 40_000_000_000];
        durations.iter().for_each(|&ns| histogram.record(ns));
        let filled: Vec<_> = histogram.filled().collect();
        let held = |ns: u64| {
            let holds = |(from, below, _): &&(u64, u64, u32)| *from <= ns && ns < *below;
            filled.iter().filter(holds).count()
        };
        assert!(durations.iter().all(|&ns| held(ns) == 1), "{filled:?}");
        let count: u64 = filled.iter().map(|(_, _, count)| u64::from(*count)).sum();
        assert_eq!(count, histogram.count);
    }

    #[test]
    fn nothing_is_filtered_out_of_the_maximum() {
        let mut histogram = Histogram::default();
        histogram.record(u64::MAX);
        assert_eq!((histogram.max_ns, histogram.count), (u64::MAX, 1));
        let mut merged = Histogram::default();
        merged.record(5);
        merged.merge(&histogram);
        assert_eq!((merged.max_ns, merged.count), (u64::MAX, 2));
        assert_eq!(Histogram::default().quantile_ns(0.99), 0);
    }
}
