//! Messages that a recording does not have, by service and place.

use std::collections::BTreeMap;
use std::fmt;

/// Where messages were lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Lost {
    /// In shared memory: the recorder did not read in time.
    Queue,
    /// In the recorder's memory: the disk did not take them in time.
    Ring,
    /// At the disk: it refused them.
    Disk,
}

impl Lost {
    /// All places.
    const ALL: [Self; 3] = [Self::Queue, Self::Ring, Self::Disk];

    /// In one word.
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::Queue => "queue",
            Self::Ring => "memory",
            Self::Disk => "disk",
        }
    }
}

/// Counts by service.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Losses(BTreeMap<String, [u64; 3]>);

impl Losses {
    pub(super) fn add(&mut self, service: &str, lost: Lost, count: u64) {
        if count == 0 {
            return;
        }
        let counts = match self.0.get_mut(service) {
            Some(counts) => counts,
            None => self.0.entry(service.into()).or_default(),
        };
        // The numbers of a foreign process may be anything.
        counts[lost as usize] = counts[lost as usize].saturating_add(count);
    }

    /// Adds those of another count.
    pub(super) fn merge(&mut self, other: &Self) {
        for (service, counts) in &other.0 {
            for lost in Lost::ALL {
                self.add(service, lost, counts[lost as usize]);
            }
        }
    }

    pub(super) fn total(&self) -> u64 {
        let counts = self.0.values().flatten();
        counts.fold(0, |sum, count| sum.saturating_add(*count))
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// As facts of a recording: `SERVICE` and `queue 3, memory 0, disk 0`.
    pub(super) fn facts(&self) -> BTreeMap<String, String> {
        let text = |counts: &[u64; 3]| {
            let parts = Lost::ALL.map(|lost| format!("{} {}", lost.word(), counts[lost as usize]));
            parts.join(", ")
        };
        let rows = self.0.iter();
        rows.map(|(service, counts)| (service.clone(), text(counts)))
            .collect()
    }
}

/// `step: queue 3, memory 0, disk 0; plan: ...`.
impl fmt::Display for Losses {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rows = self.facts().into_iter();
        let rows: Vec<_> = rows
            .map(|(service, text)| format!("{service}: {text}"))
            .collect();
        f.write_str(&rows.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_of_any_size_are_added() {
        let mut losses = Losses::default();
        losses.add("step", Lost::Queue, u64::MAX);
        losses.add("step", Lost::Queue, 3);
        losses.add("plan", Lost::Disk, 2);
        assert_eq!(losses.total(), u64::MAX);
        let text = format!(
            "plan: queue 0, memory 0, disk 2; step: queue {}, memory 0, disk 0",
            u64::MAX
        );
        assert_eq!(losses.to_string(), text);
    }
}
