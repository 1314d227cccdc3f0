/// Why a message was refused.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// A number is NaN or infinite.
    #[error("{field} is not finite")]
    NotFinite {
        /// The field.
        field: &'static str,
    },
    /// A number is outside what the field can hold.
    #[error("{field} = {value} is out of range")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// What it was.
        value: f64,
    },
    /// A count is larger than the array it counts.
    #[error("{field} = {count} is over the capacity of {capacity}")]
    OverCapacity {
        /// The field.
        field: &'static str,
        /// What it was.
        count: u64,
        /// What fits.
        capacity: u64,
    },
    /// A code that is not on its closed list.
    #[error("{field} has the unknown code {code}")]
    UnknownCode {
        /// The field.
        field: &'static str,
        /// What it was.
        code: u32,
    },
    /// The message is older than the service's age limit.
    #[error("{age_ns} ns old, over the limit of {limit_ns} ns")]
    Stale {
        /// Its age.
        age_ns: u64,
        /// The limit.
        limit_ns: u64,
    },
    /// Taken later than now.
    #[error("taken {ahead_ns} ns in the future")]
    Future {
        /// How far ahead.
        ahead_ns: u64,
    },
    /// The message belongs to an episode that is not driven now.
    #[error("is of episode {episode}, not of {expected}")]
    Episode {
        /// The message's episode.
        episode: u32,
        /// The present episode.
        expected: u32,
    },
    /// Its scheduled instant is off the run's grid.
    #[error("scheduled {off_ns} ns after an instant of the run's grid")]
    Grid {
        /// Nanoseconds since the instant before.
        off_ns: u64,
    },
    /// The sender was not started by the run for this service.
    #[error("from process {pid}, which the run did not start for it")]
    Foreign {
        /// The process that sent it.
        pid: u32,
    },
}

crate::word_list! {
    /// The kinds of refusals that are counted.
    pub enum RefusalKind {
        /// A number, a count or a code is invalid.
        Content = 0 "content",
        /// Older than the age limit.
        Stale = 1 "stale",
        /// From the future.
        Future = 2 "future",
        /// Of another episode.
        Episode = 3 "episode",
        /// Off the run's grid.
        Grid = 4 "grid",
        /// From a process that the run did not start for the service.
        Foreign = 5 "foreign",
    }
}

/// Kinds of refusals.
pub const REFUSALS: usize = RefusalKind::ALL.len();

const _: () = assert!(REFUSALS == 6, "as the health message declares");

impl Refusal {
    /// The kind under which it is counted.
    pub fn kind(&self) -> RefusalKind {
        match self {
            Self::NotFinite { .. }
            | Self::OutOfRange { .. }
            | Self::OverCapacity { .. }
            | Self::UnknownCode { .. } => RefusalKind::Content,
            Self::Stale { .. } => RefusalKind::Stale,
            Self::Future { .. } => RefusalKind::Future,
            Self::Episode { .. } => RefusalKind::Episode,
            Self::Grid { .. } => RefusalKind::Grid,
            Self::Foreign { .. } => RefusalKind::Foreign,
        }
    }
}

/// How many messages were refused, by [`RefusalKind`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Refusals {
    /// Counts, by the code of the kind.
    pub counts: [u64; REFUSALS],
}

impl Refusals {
    /// Counts one.
    pub fn count(&mut self, kind: RefusalKind) {
        self.counts[kind.code() as usize] += 1;
    }

    /// Adds the counts of another.
    pub fn add(&mut self, other: &Self) {
        for (sum, count) in self.counts.iter_mut().zip(other.counts) {
            *sum = sum.saturating_add(count);
        }
    }

    /// All of them.
    pub fn total(&self) -> u64 {
        self.counts.iter().fold(0, |sum, n| sum.saturating_add(*n))
    }

    /// The kinds that occurred, and how often.
    pub fn occurred(&self) -> impl Iterator<Item = (RefusalKind, u64)> + '_ {
        RefusalKind::ALL
            .iter()
            .map(|kind| (*kind, self.counts[kind.code() as usize]))
            .filter(|(_, count)| *count > 0)
    }
}

impl core::fmt::Display for Refusals {
    /// `3 stale, 1 foreign`; `none` without any.
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let mut separator = "";
        for (kind, count) in self.occurred() {
            write!(f, "{separator}{count} {kind}")?;
            separator = ", ";
        }
        match separator {
            "" => f.write_str("none"),
            _ => Ok(()),
        }
    }
}
