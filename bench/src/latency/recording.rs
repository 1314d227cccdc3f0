//! What the recorder of a row costs, and what its recording lacks.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::{Deserialize, Serialize};
use shm_config::Instant;

/// Seconds of an hour.
const HOUR_S: f64 = 3600.0;
/// Between two looks at the recorder's processor time, ns.
const LOOK_NS: u64 = 1_000_000_000;
/// Space of a row's recording, MB, so that no file of it is deleted; `--set` changes it.
pub const SPACE: &str = "record.max_mb=1000000";

/// The recording of one row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recorded {
    /// Messages in it.
    pub messages: u64,
    /// Bytes of its files.
    pub bytes: u64,
    /// Its files.
    pub files: u64,
    /// From its first message to its last, s.
    pub elapsed_s: f64,
    /// Messages that it lacks, by the recorder's last report.
    pub lost: u64,
    /// The same by service, each with the places where they were lost.
    pub lost_by_service: BTreeMap<String, String>,
    /// The recorder's processor time over the time in which it was measured: its share of a
    /// core.
    pub core_share: f64,
}

impl Recorded {
    /// Reads the recording of a finished row; `lost` is the recorder's own report.
    ///
    /// # Errors
    /// If there is no recording, or it cannot be read.
    pub fn read(folder: &Path, lost: u64, core_share: f64) -> anyhow::Result<Self> {
        let folder = newest(folder)?;
        let recording = recorder::Recording::open(&folder)?;
        let length = |path: &Path| fs::metadata(path).map_or(0, |metadata| metadata.len());
        let (first_ns, last_ns) = recording.span_ns().unwrap_or_default();
        let counts = recording.counts();
        let pairs = recording.lost();
        Ok(Self {
            messages: counts.values().map(|count| count.messages).sum(),
            bytes: recording.files().map(length).sum(),
            files: recording.files().count() as u64,
            elapsed_s: last_ns.saturating_sub(first_ns) as f64 * 1e-9,
            lost,
            lost_by_service: pairs
                .map(|(name, at)| (name.to_string(), at.to_string()))
                .collect(),
            core_share,
        })
    }

    /// Gigabytes of an hour at this rate.
    pub fn gb_per_hour(&self) -> f64 {
        self.bytes as f64 * 1e-9 * HOUR_S / self.elapsed_s.max(1e-9)
    }

    /// In words, one line for each fact.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![
            format!(
                "recording: {} messages of {:.1} s in {} files, {} bytes, {:.3} GB an hour",
                self.messages,
                self.elapsed_s,
                self.files,
                self.bytes,
                self.gb_per_hour()
            ),
            format!("recorder: {:.2} % of a core", 100.0 * self.core_share),
            format!("messages lost by the recorder: {}", self.lost),
        ];
        let by_service = self.lost_by_service.iter();
        lines.extend(by_service.map(|(service, places)| format!("  {service}: {places}")));
        lines
    }
}

/// The recording in this folder: its own files, or those of the newest folder in it, as each
/// start of a run makes one.
fn newest(folder: &Path) -> anyhow::Result<PathBuf> {
    let entries = fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let inner = entries.flatten().map(|entry| entry.path());
    let inner = inner.filter(|path| path.is_dir()).max();
    Ok(inner.unwrap_or_else(|| folder.to_path_buf()))
}

/// The processor time of the recorder, over its restarts.
#[derive(Debug, Default)]
pub struct CoreShare {
    begun: Option<(Instant, f64)>,
    looked: Option<Instant>,
    spent_s: BTreeMap<u32, f64>,
}

impl CoreShare {
    /// Notes the processor time of the recorder with this process id, once a second.
    pub fn look(&mut self, pid: u32, now: Instant) {
        if self.looked.is_some_and(|at| now.since_ns(at) < LOOK_NS) {
            return;
        }
        if let Some(spent_s) = processor_s(pid) {
            self.looked = Some(now);
            self.begun.get_or_insert((now, spent_s));
            self.spent_s.insert(pid, spent_s);
        }
    }

    /// Processor time over the time between the first and the last look; 0 with one look.
    pub fn share(&self) -> f64 {
        let (Some((begun, before_s)), Some(last)) = (self.begun, self.looked) else {
            return 0.0;
        };
        let elapsed_s = last.since_ns(begun) as f64 * 1e-9;
        let spent_s = self.spent_s.values().sum::<f64>() - before_s;
        if elapsed_s > 0.0 {
            spent_s / elapsed_s
        } else {
            0.0
        }
    }
}

/// The processor time of all threads of a process, s; `None` when it has ended.
fn processor_s(pid: u32) -> Option<f64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name before it may have blanks; user and system time are the 12th and 13th field
    // after it.
    let after_name = stat.rsplit(')').next()?;
    let ticks = after_name.split_whitespace().skip(11).take(2);
    let ticks: f64 = ticks.filter_map(|ticks| ticks.parse::<f64>().ok()).sum();
    Some(ticks / rustix::param::clock_ticks_per_second() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_of_a_core_is_over_all_restarts() {
        let at = |s: u64| Instant(s * 1_000_000_000);
        let mut share = CoreShare::default();
        assert_eq!(share.share(), 0.0);
        share.look(std::process::id(), at(10));
        assert_eq!(share.share(), 0.0);
        share.begun = Some((at(10), 1.0));
        share.looked = Some(at(20));
        share.spent_s = BTreeMap::from([(1, 1.3), (2, 0.2)]);
        assert!((share.share() - 0.05).abs() < 1e-9, "{share:?}");
    }

    #[test]
    fn the_lines_name_each_loss_its_service_and_its_place() {
        let recorded = Recorded {
            messages: 36_000,
            bytes: 1_000_000,
            files: 1,
            elapsed_s: 3.6,
            lost: 3,
            lost_by_service: BTreeMap::from([("step".into(), "queue 3, memory 0, disk 0".into())]),
            core_share: 0.031,
        };
        let lines = recorded.lines();
        assert!(lines[0].ends_with("1.000 GB an hour"), "{lines:?}");
        assert_eq!(lines[1], "recorder: 3.10 % of a core");
        assert_eq!(lines[2], "messages lost by the recorder: 3");
        assert_eq!(lines[3], "  step: queue 3, memory 0, disk 0");
    }
}
