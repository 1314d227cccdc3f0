//! A histogram in a file: all buckets with a count above 0.

use std::path::Path;

use anyhow::Context;
use serde::{Deserialize, Serialize};
use shm_config::message::Histogram;

use crate::driven::Quantiles;

/// Number of durations from `from_ns` up to, but not including, `below_ns`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bucket {
    /// Lower bound, ns.
    pub from_ns: u64,
    /// Upper bound, ns; the lower bound of the next bucket.
    pub below_ns: u64,
    /// Number of durations.
    pub count: u64,
}

/// Histogram of one measure of one process or floor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Series {
    /// Process or floor, such as controller or cyclictest.
    pub of: String,
    /// Measure, such as `release_lateness`.
    pub measure: String,
    /// Buckets in ascending order; empty ones are left out.
    pub buckets: Vec<Bucket>,
}

/// One line of a file of series.
#[derive(Serialize, Deserialize)]
struct Line {
    process: String,
    measure: String,
    from_ns: u64,
    below_ns: u64,
    count: u64,
}

impl Series {
    /// Converts a histogram of the processes.
    pub fn of_histogram(of: &str, measure: &str, histogram: &Histogram) -> Self {
        let buckets = histogram.filled().map(|(from_ns, below_ns, count)| Bucket {
            from_ns,
            below_ns,
            count: u64::from(count),
        });
        Self {
            of: of.into(),
            measure: measure.into(),
            buckets: buckets.collect(),
        }
    }

    /// Total number of durations.
    pub fn count(&self) -> u64 {
        self.buckets.iter().map(|bucket| bucket.count).sum()
    }

    /// Quantiles, us: the middle of the bucket of each quantile, limited to the exact maximum
    /// `max_us`. `None` if nothing was counted.
    pub fn quantiles(&self, max_us: f64) -> Option<Quantiles> {
        let total = self.count();
        let at = |quantile: f64| {
            let rank = (quantile * total as f64).ceil().max(1.0) as u64;
            let mut seen = 0;
            let holding = self.buckets.iter().find(|bucket| {
                seen += bucket.count;
                seen >= rank
            });
            let middle = |bucket: &Bucket| (bucket.from_ns + bucket.below_ns) as f64 / 2e3;
            holding.map_or(0.0, middle).min(max_us)
        };
        (total > 0).then(|| Quantiles {
            p50: at(0.5),
            p99: at(0.99),
            p999: at(0.999),
            max: max_us,
        })
    }
}

/// Reads a file with the columns process, measure, `from_ns`, `below_ns`, count.
///
/// # Errors
/// If it does not exist or has another form.
pub fn read(path: &Path) -> anyhow::Result<Vec<Series>> {
    let mut all: Vec<Series> = Vec::new();
    let mut reader = csv::Reader::from_path(path).with_context(|| path.display().to_string())?;
    for line in reader.deserialize() {
        let line: Line = line.with_context(|| path.display().to_string())?;
        let bucket = Bucket {
            from_ns: line.from_ns,
            below_ns: line.below_ns,
            count: line.count,
        };
        match all.last_mut() {
            Some(last) if last.of == line.process && last.measure == line.measure => {
                last.buckets.push(bucket);
            }
            _ => all.push(Series {
                of: line.process,
                measure: line.measure,
                buckets: vec![bucket],
            }),
        }
    }
    Ok(all)
}

/// Writes a file for [`read`].
///
/// # Errors
/// If it cannot be written.
pub fn write(path: &Path, all: &[Series]) -> anyhow::Result<()> {
    let named = || path.display().to_string();
    let mut writer = csv::Writer::from_path(path).with_context(named)?;
    for series in all {
        for bucket in &series.buckets {
            let line = Line {
                process: series.of.clone(),
                measure: series.measure.clone(),
                from_ns: bucket.from_ns,
                below_ns: bucket.below_ns,
                count: bucket.count,
            };
            writer.serialize(line).with_context(named)?;
        }
    }
    writer.flush().with_context(named)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// /dev/full refuses every byte: no space left.
    #[test]
    fn a_full_disk_is_reported_with_the_file() {
        let bucket = |from_ns| Bucket {
            from_ns,
            below_ns: from_ns + 1,
            count: 1,
        };
        let mut series = Series {
            of: "controller".into(),
            measure: "execution".into(),
            buckets: Vec::new(),
        };
        // Smaller than the write buffer, and larger.
        for count in [1, 10_000] {
            series.buckets = (0..count).map(bucket).collect();
            let error = write(Path::new("/dev/full"), std::slice::from_ref(&series));
            let message = format!("{:#}", error.expect_err("it is full"));
            assert!(
                message.starts_with("/dev/full: ") && message.contains("No space"),
                "{message}"
            );
        }
    }

    #[test]
    fn what_is_written_is_read_and_nothing_is_lost() {
        let mut histogram = Histogram::default();
        for ns in [3, 1_000, 1_000, 52_345, 16_000_000_000] {
            histogram.record(ns);
        }
        let lateness = Series::of_histogram("floor", "release_lateness", &histogram);
        let other = Series {
            measure: "execution".into(),
            ..lateness.clone()
        };
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("row.csv");
        write(&path, &[lateness.clone(), other.clone()]).expect("written");
        let all = read(&path).expect("read");
        assert_eq!(all, [lateness.clone(), other]);
        assert_eq!(lateness.count(), 5);
        let quantiles = lateness.quantiles(16_000_000.0).expect("five");
        assert!((quantiles.p50 - 1.0).abs() < 0.064);
        assert_eq!(quantiles.max, 16_000_000.0);
        assert!((quantiles.p99 / 16_000_000.0 - 1.0).abs() < 1e-2);
    }
}
