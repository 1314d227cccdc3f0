//! All runs of the user on one page: `./vlaps view --all`.
//!
//! ```text
//! runs of this machine -> watch -> a reader for each -> entries -> hub -> connections
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`watch`] | finds runs, starts their readers, publishes the cards |
//! | [`reader`] | reads one run for its card, and for its page while one is open |
//! | [`entry`] | a run on the page, and what its reader keeps there |
//! | [`card`] | what the page shows of a run |
//! | [`state`] | which run needs attention, and the order of the cards |
//! | [`minute`] | who drove in the last minute |
//! | [`machine`] | the machine that a mirrored run comes from |

pub mod card;
pub mod entry;
pub mod machine;
pub mod minute;
pub mod reader;
pub mod state;
pub mod watch;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::Serialize;
use shm_config::Instant;
use shm_config::message::Driver;
use shm_config::palette::{driver, hex};
use shm_config::run::{RunName, RunPaths};
use supervisor::Clock;

use super::hub::Hub;
use card::Card;
use entry::Entry;

/// Runs on one page. A card with its scene is 10 kB, so that a message of all cards has
/// at most 0.6 MB; an open page of a run keeps 10 MB.
pub const RUNS_MAX: usize = 64;
/// Time for which an ended run stays listed, ns: ten minutes.
pub const ENDED_NS: u64 = 600_000_000_000;
/// The same for a run of which no step was read, ns: it has nothing to show.
const UNDRIVEN_NS: u64 = 10_000_000_000;
/// Time without a page after which readers are closed, ns: a page that is loaded again
/// finds them.
pub const LET_GO_NS: u64 = 10_000_000_000;

/// The runs of the user.
#[derive(Debug)]
pub struct Fleet {
    /// For the page of all runs.
    pub hub: Arc<Hub>,
    clock: Clock,
    entries: Mutex<BTreeMap<String, Arc<Entry>>>,
}

/// What the page of all runs has to know before it draws.
#[derive(Debug, Serialize)]
struct Hello {
    mode: &'static str,
    /// Name and colour of each driver, by its bit in a band.
    drivers: Vec<(&'static str, String)>,
}

/// All cards, the most urgent first.
#[derive(Debug, Serialize)]
struct Cards {
    runs: Vec<Card>,
    /// Living runs that have no card, because there are too many.
    left_out: usize,
    /// Why the runs cannot be listed; empty else.
    note: String,
}

impl Fleet {
    /// Without a run; `clock` tells the ages.
    pub fn new(clock: Clock) -> Self {
        let hub = Hub::default();
        let drivers = Driver::ALL.iter();
        let hello = Hello {
            mode: "fleet",
            drivers: drivers.map(|one| (one.word(), hex(driver(*one)))).collect(),
        };
        hub.begin(&serde_json::to_string(&hello).unwrap_or_default());
        Self {
            hub: Arc::new(hub),
            clock,
            entries: Mutex::default(),
        }
    }

    /// Now, on the machine's clock.
    pub fn now(&self) -> Instant {
        (self.clock)()
    }

    /// The run of this name: one that has a card, or one that lives. `None` when there is
    /// none, or no room.
    pub fn open(&self, name: &RunName) -> Option<Arc<Entry>> {
        let known = self.entries().get(&name.to_string()).cloned();
        if known.is_some() {
            return known;
        }
        RunPaths::new(name.clone()).supervisor_pid()?;
        self.add(name)
    }

    /// The runs that have a card.
    pub fn all(&self) -> Vec<Arc<Entry>> {
        self.entries().values().cloned().collect()
    }

    /// Gives a living run a card; the card of the run that ended first makes room. `None`
    /// when all cards are of living runs.
    fn add(&self, name: &RunName) -> Option<Arc<Entry>> {
        let now = self.now();
        let mut entries = self.entries();
        if let Some(known) = entries.get(&name.to_string()) {
            return Some(known.clone());
        }
        if entries.len() >= RUNS_MAX {
            let ended = entries.iter().filter_map(|(name, entry)| {
                let end = entry.end()?;
                Some((end, name.clone()))
            });
            let (_, oldest) = ended.min()?;
            entries.remove(&oldest);
        }
        let entry = Arc::new(Entry::new(name.clone(), now));
        entries.insert(name.to_string(), entry.clone());
        Some(entry)
    }

    /// Removes the cards of runs that ended long ago.
    fn forget(&self, now: Instant) {
        let is_old = |entry: &Entry| {
            let kept_ns = match entry.has_driven() {
                true => ENDED_NS,
                false => UNDRIVEN_NS,
            };
            entry.end().is_some_and(|end| now.since_ns(end) > kept_ns)
        };
        self.entries()
            .retain(|_, entry| !is_old(entry) || entry.hub.clients() > 0);
    }

    /// All cards as JSON.
    fn cards(&self, left_out: usize, note: String) -> String {
        let now = self.now();
        let mut runs: Vec<Card> = self.all().iter().map(|entry| entry.card(now)).collect();
        runs.sort_by(|a, b| a.order().cmp(&b.order()));
        let cards = Cards {
            runs,
            left_out,
            note,
        };
        serde_json::to_string(&cards).unwrap_or_default()
    }

    fn entries(&self) -> MutexGuard<'_, BTreeMap<String, Arc<Entry>>> {
        // The map is whole between two statements that change it.
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noon() -> Instant {
        Instant(10 * ENDED_NS)
    }

    fn name(k: usize) -> RunName {
        format!("r{k}").parse().expect("a name")
    }

    #[test]
    fn the_cards_are_limited_and_the_run_that_ended_first_makes_room() {
        let fleet = Fleet::new(noon);
        for k in 0..RUNS_MAX {
            assert!(fleet.add(&name(k)).is_some(), "{k}");
        }
        assert!(fleet.add(&name(100)).is_none());
        assert!(fleet.add(&name(7)).is_some(), "it has a card already");
        for (k, end_ns) in [(5, 9), (6, 8)] {
            let entry = fleet.add(&name(k)).expect("a card");
            entry.has_ended(Instant(end_ns));
        }
        assert!(fleet.add(&name(100)).is_some());
        let names: Vec<_> = fleet.all().iter().map(|one| one.name.to_string()).collect();
        assert!(names.contains(&"r5".into()) && !names.contains(&"r6".into()));
        assert_eq!(names.len(), RUNS_MAX);
    }

    #[test]
    fn an_ended_run_stays_listed_for_a_while() {
        let fleet = Fleet::new(noon);
        let entry = fleet.add(&name(1)).expect("a card");
        entry.change(|kept| kept.facts.newest = Some(Instant(1)));
        entry.has_ended(Instant(1));
        let undriven = fleet.add(&name(2)).expect("a card");
        undriven.has_ended(Instant(1));
        fleet.forget(Instant(1 + UNDRIVEN_NS));
        assert_eq!(fleet.all().len(), 2);
        fleet.forget(Instant(1 + ENDED_NS));
        assert_eq!(fleet.all().len(), 1);
        fleet.forget(Instant(2 + ENDED_NS));
        assert_eq!(fleet.all().len(), 0);
    }

    #[test]
    fn a_run_that_is_unknown_and_does_not_live_cannot_be_opened() {
        let fleet = Fleet::new(noon);
        assert!(fleet.open(&name(1)).is_none());
        assert!(fleet.all().is_empty());
        fleet.add(&name(1));
        assert!(fleet.open(&name(1)).is_some());
    }

    #[test]
    fn urgent_cards_come_first() {
        let fleet = Fleet::new(noon);
        fleet.add(&name(1)).expect("a card").has_ended(noon());
        fleet.add(&name(3));
        let silent = fleet.add(&name(4)).expect("a card");
        silent.change(|kept| {
            kept.facts.newest = Some(Instant(1));
        });
        let text = fleet.cards(2, String::new());
        let cards: serde_json::Value = serde_json::from_str(&text).expect("JSON");
        let shown = cards["runs"].as_array().expect("runs").iter();
        let shown: Vec<_> = shown.map(|run| (&run["name"], &run["state"])).collect();
        let expected = serde_json::json!([["r4", "silent"], ["r3", "starting"], ["r1", "ended"]]);
        assert_eq!(serde_json::to_value(shown).expect("JSON"), expected);
        assert_eq!(cards["left_out"], 2);
    }
}
