//! Measures the machine's floor with `cyclictest` of rt-tests.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Stdio};

use anyhow::{Context, bail};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

use super::buckets::{Bucket, Series};
use super::stress::SPARE_S;
use crate::driven::Punctuality;
use crate::floor::{Priority, controller, controllers_core};

/// Range of its histogram, us: 1 s, which takes 8 MB. Longer latencies are counted as
/// overflow, and their maximum is reported.
const LONGEST_US: u64 = 1_000_000;

/// Whether cyclictest is on PATH.
pub fn is_there() -> bool {
    // --help is the only option that succeeds without measuring.
    super::answers("cyclictest", &["--help"])
}

/// A running cyclictest.
pub struct Cyclictest {
    child: Child,
    folder: tempfile::TempDir,
    period_ns: u64,
    priority: Priority,
}

impl Cyclictest {
    /// Starts one thread at the controller's priority, core and period, with locked memory
    /// and absolute sleeps on the monotonic clock (cyclictest's defaults).
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(rate_hz: f64, priority: Priority, seconds: f64) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir()?;
        let mut command = super::beside("cyclictest");
        let period_us = (1e6 / rate_hz).round() as u64;
        command.args(["--quiet", "--threads=1", "--default-system"]);
        command.arg(format!("--interval={period_us}"));
        // It ends by itself, even if this program is killed.
        let end_s = (seconds + SPARE_S).ceil();
        command.arg(format!("--duration={end_s}"));
        command.arg(format!("--histogram={LONGEST_US}"));
        command.arg(format!("--json={}", file(folder.path()).display()));
        if priority == Priority::Asked
            && let Some(row) = controller()
        {
            command.arg("--mlockall");
            command.arg(format!("--priority={}", row.priority));
            if let Some(core) = controllers_core() {
                command.arg(format!("--affinity={core}"));
            }
        }
        let child = command
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .context("cyclictest")?;
        Ok(Self {
            child,
            folder,
            period_ns: period_us * 1000,
            priority,
        })
    }

    /// Stops it and returns its measurement.
    ///
    /// # Errors
    /// If it refused to run or its output cannot be read.
    pub fn finish(mut self) -> anyhow::Result<(Punctuality, Series)> {
        self.end(Signal::INT);
        let status = self.child.wait()?;
        let path = file(self.folder.path());
        let text = std::fs::read_to_string(&path).with_context(|| {
            format!(
                "cyclictest ended ({status}) without output: it may not be allowed to use real-time \
                 priority (`./vlaps doctor`); --floor own measures without it"
            )
        })?;
        read(&text, self.period_ns, self.priority)
    }

    fn end(&self, signal: Signal) {
        if let Some(pid) = Pid::from_raw(self.child.id() as i32) {
            let _ = kill_process(pid, signal);
        }
    }
}

impl Drop for Cyclictest {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            self.end(Signal::KILL);
            let _ = self.child.wait();
        }
    }
}

fn file(folder: &Path) -> std::path::PathBuf {
    folder.join("cyclictest.json")
}

/// Parses its JSON output with one thread.
fn read(text: &str, period_ns: u64, priority: Priority) -> anyhow::Result<(Punctuality, Series)> {
    let value: Value = serde_json::from_str(text).context("cyclictest's JSON")?;
    let thread = &value["thread"]["0"];
    let (Some(counts), Some(ticks), Some(max_us)) = (
        thread["histogram"].as_object(),
        thread["cycles"].as_u64(),
        thread["max"].as_u64(),
    ) else {
        bail!("cyclictest's JSON has no histogram of a thread");
    };
    let mut buckets = Vec::new();
    for (us, count) in counts {
        let us: u64 = us.parse().context("cyclictest's histogram")?;
        buckets.push(Bucket {
            from_ns: us * 1000,
            below_ns: (us + 1) * 1000,
            count: count.as_u64().context("cyclictest's histogram")?,
        });
    }
    buckets.sort_by_key(|bucket| bucket.from_ns);
    let mut series = Series {
        of: "cyclictest".into(),
        measure: "release_lateness".into(),
        buckets,
    };
    let over = ticks.saturating_sub(series.count());
    if over > 0 {
        series.buckets.push(Bucket {
            from_ns: LONGEST_US * 1000,
            below_ns: (max_us.max(LONGEST_US) + 1) * 1000,
            count: over,
        });
    }
    let missed = add_missed(&mut series, period_ns);
    let lateness_us = series.quantiles((max_us + 1) as f64);
    let punctuality = Punctuality {
        ticks,
        skipped: missed,
        missed,
        // From cyclictest's own count of cycles, as the processes count their grids.
        elapsed_s: ((ticks + missed) * period_ns) as f64 / 1e9,
        lateness_us,
        priority: match priority {
            Priority::Asked => "granted".into(),
            Priority::Ordinary => "not asked".into(),
        },
        ..Punctuality::default()
    };
    Ok((punctuality, series))
}

/// Adds the instants that cyclictest slept through, which it does not report: as many
/// as fit into each lateness. Each is as late as from its own instant to that wake-up,
/// like the skipped ticks of a set. Returns their number.
fn add_missed(series: &mut Series, period_ns: u64) -> u64 {
    let mut all: BTreeMap<(u64, u64), u64> = BTreeMap::new();
    let mut missed = 0;
    for bucket in &series.buckets {
        let passed = bucket.from_ns / period_ns;
        missed += passed * bucket.count;
        for earlier in 0..=passed {
            let less_ns = earlier * period_ns;
            let bounds = (bucket.from_ns - less_ns, bucket.below_ns - less_ns);
            *all.entry(bounds).or_default() += bucket.count;
        }
    }
    let buckets = all.iter().map(|(&(from_ns, below_ns), &count)| Bucket {
        from_ns,
        below_ns,
        count,
    });
    series.buckets = buckets.collect();
    missed
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn its_histogram_is_read_whole_with_what_overflowed() {
        let text = r#"{"thread": {"0": {
            "histogram": {"9": 90, "12": 7, "25000": 2},
            "cycles": 100, "min": 9, "max": 2500000, "avg": 10.0, "cpu": 0
        }}}"#;
        let (floor, series) = read(text, 10_000_000, Priority::Asked).expect("its JSON");
        // Each latency of 25 ms slept through two ticks, the longest one through 100.
        assert_eq!((floor.ticks, floor.missed), (100, 2 * 2 + 100));
        assert_eq!(floor.elapsed_s, 2.04);
        assert_eq!(series.count(), 204);
        let late = |from_ns| {
            let mut buckets = series.buckets.iter();
            buckets
                .find(|bucket| bucket.from_ns == from_ns)
                .map(|bucket| bucket.count)
        };
        let ms = [5, 15, 25, 980, 1000].map(|ms| late(ms * 1_000_000));
        assert_eq!(ms, [Some(2), Some(2), Some(2), Some(1), Some(1)]);
        let max_us = floor.lateness_us.map(|us| us.max);
        assert_eq!(max_us, Some(2_500_001.0));
        let whole = read(text, 3_000_000_000, Priority::Asked).expect("its JSON");
        assert_eq!((whole.0.missed, whole.1.count()), (0, 100));
        let us = whole.0.lateness_us.expect("lateness");
        assert_eq!([us.p50, us.p99], [9.5, 25_000.5]);
        let broken = read("{}", 1, Priority::Asked).expect_err("no thread");
        assert!(broken.to_string().contains("no histogram"), "{broken}");
    }
}
