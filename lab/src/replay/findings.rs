//! What a replay found: how many messages were recomputed, and which differ.

use serde::Serialize;
use shm_config::difference;
use shm_config::layout::Layout;
use shm_config::message::{Header, Message};
use shm_config::services::Process;

/// Differences that are kept whole; of more the number is kept.
const KEPT: usize = 1000;

/// A recorded value that the shipped code does not give again.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Difference {
    /// The tick of the message.
    pub tick: u64,
    /// The process that sent it.
    pub process: &'static str,
    /// The message and its field, such as `plan.waypoints[3].x_body_m`.
    pub field: String,
    /// The recorded value.
    pub recorded: String,
    /// The recomputed value.
    pub recomputed: String,
    /// The episode of the message.
    pub episode: u32,
    /// When it was taken, ns on the run's clock.
    pub taken_ns: u64,
}

/// Where in the run a difference is: the stretch, then the instant, then the process in the
/// order in which a tick goes through them.
type Place = (u64, u32, u64, u32);

/// A difference and its place.
#[derive(Clone, Debug)]
pub struct Found {
    place: Place,
    /// Bytes of the message that differ; 1 where its content is right and its place is not.
    bytes: u64,
    difference: Difference,
}

impl Found {
    /// A difference in this field of a message.
    pub fn new(
        process: Process,
        (stretch, header): (u64, &Header),
        field: impl Into<String>,
        (recorded, recomputed): (impl ToString, impl ToString),
    ) -> Found {
        Found {
            place: (stretch, header.episode, header.taken_ns, process.code()),
            bytes: 1,
            difference: Difference {
                tick: header.tick,
                process: process.word(),
                field: field.into(),
                recorded: recorded.to_string(),
                recomputed: recomputed.to_string(),
                episode: header.episode,
                taken_ns: header.taken_ns,
            },
        }
    }

    /// The first field in which the recorded message differs; `None` when all bytes are
    /// equal.
    pub fn in_message<M: Message + Layout>(
        process: Process,
        stretch: u64,
        name: &str,
        (recorded, recomputed): (&M, &M),
    ) -> Option<Found> {
        let found = difference::first_difference(recorded, recomputed)?;
        let field = match name {
            "" => found.field,
            name => format!("{name}.{}", found.field),
        };
        let at = (stretch, recorded.header());
        let pairs = recorded.as_bytes().iter().zip(recomputed.as_bytes());
        let bytes = pairs.filter(|(one, other)| one != other).count() as u64;
        Some(Found {
            bytes,
            ..Found::new(process, at, field, (found.left, found.right))
        })
    }
}

/// What was found of one process.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Tally {
    /// Messages that were recomputed.
    pub recomputed: u64,
    /// Those that differ.
    pub different: u64,
    /// Messages that could not be recomputed because what they depend on is not in the
    /// recording.
    pub unknown: u64,
}

/// What was found so far.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    tallies: Vec<(Process, Tally)>,
    found: Vec<Found>,
    bytes: u64,
    first: Option<Found>,
    /// The only tick of which differences are kept.
    only: Option<u64>,
}

impl Findings {
    /// Of one tick, or of all.
    pub fn of_tick(only: Option<u64>) -> Self {
        Self {
            only,
            ..Self::default()
        }
    }

    /// The figures of a process.
    pub fn tally(&mut self, process: Process) -> &mut Tally {
        let at = self.tallies.iter().position(|(of, _)| *of == process);
        let at = at.unwrap_or_else(|| {
            self.tallies.push((process, Tally::default()));
            self.tallies.len() - 1
        });
        &mut self.tallies[at].1
    }

    /// Counts messages that were recomputed.
    pub fn count(&mut self, process: Process, recomputed: usize) {
        self.tally(process).recomputed += recomputed as u64;
    }

    /// Counts messages whose origins are not recorded.
    pub fn unknown(&mut self, process: Process) {
        self.tally(process).unknown += 1;
    }

    /// Adds differences: one for each message that differs.
    pub fn add(&mut self, process: Process, found: impl IntoIterator<Item = Found>) {
        let only = self.only;
        let is_asked = |found: &Found| only.is_none_or(|only| found.difference.tick == only);
        for found in found.into_iter().filter(is_asked) {
            self.tally(process).different += 1;
            self.bytes += found.bytes;
            if self
                .first
                .as_ref()
                .is_none_or(|first| found.place < first.place)
            {
                self.first = Some(found.clone());
            }
            if self.found.len() < KEPT {
                self.found.push(found);
            }
        }
    }

    /// Adds what was found of other messages.
    pub fn merge(&mut self, other: Findings) {
        for (process, tally) in other.tallies {
            let own = self.tally(process);
            own.recomputed += tally.recomputed;
            own.different += tally.different;
            own.unknown += tally.unknown;
        }
        self.bytes += other.bytes;
        let room = KEPT.saturating_sub(self.found.len());
        self.found.extend(other.found.into_iter().take(room));
        let firsts = [self.first.take(), other.first].into_iter().flatten();
        self.first = firsts.min_by_key(|found| found.place);
    }

    /// Bytes that differ.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Messages that differ.
    pub fn different(&self) -> u64 {
        self.tallies.iter().map(|(_, tally)| tally.different).sum()
    }

    /// The first difference of the run.
    pub fn first(&self) -> Option<&Difference> {
        self.first.as_ref().map(|found| &found.difference)
    }

    /// The first thousand differences that were found, in order of the run.
    pub fn differences(&self) -> Vec<&Difference> {
        let mut found: Vec<_> = self.found.iter().collect();
        found.sort_by_key(|found| found.place);
        found.into_iter().map(|found| &found.difference).collect()
    }

    /// The figures of each process.
    pub fn tallies(&self) -> impl Iterator<Item = (Process, &Tally)> {
        self.tallies
            .iter()
            .map(|(process, tally)| (*process, tally))
    }
}
