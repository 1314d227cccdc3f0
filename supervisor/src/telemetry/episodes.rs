//! The finished episodes of a run, in bounded memory.

use std::collections::BTreeMap;

use sha2::{Digest, Sha256};
use shm_config::message::{Episode, Outcome};

/// The number of newest episodes that are kept whole: 1.4 MB. Of the older ones the counts and the
/// digest stay, so that a run may drive without end.
pub const EPISODES_KEPT: usize = 10_000;

/// The sums over all finished episodes.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct EpisodeTotals {
    /// Finished episodes.
    pub count: usize,
    /// Episodes that arrived without contact.
    pub strict: usize,
    /// Ticks on which the world braked because no recent command existed.
    pub braked: u64,
    /// Episodes by [`Outcome`].
    pub outcomes: BTreeMap<&'static str, usize>,
}

impl EpisodeTotals {
    fn add(&mut self, episode: &Episode) {
        self.count += 1;
        self.strict += usize::from(episode.is_strict_success());
        self.braked += episode.braked;
        *self.outcomes.entry(episode.outcome().word()).or_default() += 1;
    }

    /// Episodes with this outcome.
    pub fn with(&self, outcome: Outcome) -> usize {
        self.outcomes.get(outcome.word()).copied().unwrap_or(0)
    }
}

/// The finished episodes: the newest whole, all of them added up.
#[derive(Debug, Default)]
pub struct Episodes {
    kept: BTreeMap<u32, Episode>,
    /// The sums over episodes that are not kept any more.
    past: EpisodeTotals,
    past_digest: Sha256,
}

impl Episodes {
    /// Adds one; it replaces an earlier one of the same number.
    pub fn insert(&mut self, episode: Episode) {
        self.kept.insert(episode.header.episode, episode);
        if self.kept.len() > EPISODES_KEPT
            && let Some((_, oldest)) = self.kept.pop_first()
        {
            self.past.add(&oldest);
            self.past_digest.update(oldest.command_digest);
        }
    }

    /// The newest, in order; at most [`EPISODES_KEPT`].
    pub fn kept(&self) -> impl ExactSizeIterator<Item = &Episode> {
        self.kept.values()
    }

    /// Whether none is finished.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// The number of the next episode.
    pub fn next(&self) -> u32 {
        self.kept
            .last_key_value()
            .map_or(0, |(number, _)| number.saturating_add(1))
    }

    /// The sums over all of them.
    pub fn totals(&self) -> EpisodeTotals {
        let mut totals = self.past.clone();
        for episode in self.kept() {
            totals.add(episode);
        }
        totals
    }

    /// SHA-256 over the digests of all episodes' commands, in order, as hexadecimal
    /// digits; `None` without any.
    pub fn command_digest(&self) -> Option<String> {
        (!self.is_empty()).then(|| digits(self.past_digest.clone(), self.kept()))
    }
}

/// SHA-256 over the digests of these episodes' commands, in order, as hexadecimal digits.
pub fn command_digest<'a>(episodes: impl Iterator<Item = &'a Episode>) -> String {
    digits(Sha256::new(), episodes)
}

fn digits<'a>(mut digest: Sha256, episodes: impl Iterator<Item = &'a Episode>) -> String {
    for episode in episodes {
        digest.update(episode.command_digest);
    }
    let digest = digest.finalize();
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(number: u32) -> Episode {
        let mut episode = Episode {
            outcome: Outcome::Arrived.code(),
            command_digest: [number as u8; 32],
            braked: 1,
            ..Episode::default()
        };
        episode.header.episode = number;
        episode
    }

    #[test]
    fn a_run_without_end_keeps_the_newest_and_counts_all() {
        let count = EPISODES_KEPT as u32 + 5;
        let mut episodes = Episodes::default();
        assert_eq!(episodes.command_digest(), None);
        let all: Vec<_> = (0..count).map(episode).collect();
        for episode in &all {
            episodes.insert(*episode);
        }
        assert_eq!(episodes.kept().len(), EPISODES_KEPT);
        assert_eq!(episodes.kept().next().map(|e| e.header.episode), Some(5));
        assert_eq!(episodes.next(), count);
        let totals = episodes.totals();
        assert_eq!(totals.count, count as usize);
        assert_eq!(totals.with(Outcome::Arrived), count as usize);
        assert_eq!(totals.braked, u64::from(count));
        assert_eq!(episodes.command_digest(), Some(command_digest(all.iter())));
    }

    #[test]
    fn an_episode_of_the_same_number_takes_the_place_of_the_one_before() {
        let mut episodes = Episodes::default();
        episodes.insert(episode(0));
        episodes.insert(episode(0));
        assert_eq!((episodes.totals().count, episodes.next()), (1, 1));
    }
}
