//! A run on the page of all runs: its reader writes, the page's connections read.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use shm_config::Instant;
use shm_config::run::RunName;
use shm_config::text::printable;

use super::card::{Card, Figures};
use super::machine::Machine;
use super::minute::Minute;
use super::state::{Facts, State};
use crate::live::hello::Hello;
use crate::live::hub::Hub;
use crate::live::scene::rounded;

/// Time after a failed opening until the next one, ns.
const RETRY_NS: u64 = 1_000_000_000;
/// Longest reason that is shown, characters.
const NOTE_MAX: usize = 300;

/// A run on the page.
#[derive(Debug)]
pub struct Entry {
    /// Its name.
    pub name: RunName,
    /// For the page of this run alone.
    pub hub: Arc<Hub>,
    kept: Mutex<Kept>,
}

/// What is known of a run.
#[derive(Debug, Default)]
pub struct Kept {
    /// From which its state follows.
    pub facts: Facts,
    /// What its processes tell.
    pub figures: Figures,
    /// Who drove.
    pub minute: Minute,
    /// Where it comes from.
    pub machine: Option<Machine>,
    /// The newest scene, JSON.
    pub scene: Arc<str>,
    /// The newest sample, JSON.
    pub sample: Arc<str>,
    /// Text of the last fault.
    pub fault: String,
    is_read: bool,
    /// When it could last not be opened.
    failed: Option<Instant>,
}

impl Entry {
    /// A run that was just found.
    pub fn new(name: RunName, now: Instant) -> Self {
        let hub = Hub::default();
        hub.begin(&Hello::waiting(format!("run '{name}' is being opened")).json());
        let kept = Kept {
            facts: Facts {
                opened: now,
                ..Facts::default()
            },
            ..Kept::default()
        };
        Self {
            name,
            hub: Arc::new(hub),
            kept: Mutex::new(kept),
        }
    }

    /// Whether a step of it was read.
    pub fn has_driven(&self) -> bool {
        self.kept().facts.newest.is_some()
    }

    /// Changes what is known.
    pub fn change<T>(&self, change: impl FnOnce(&mut Kept) -> T) -> T {
        change(&mut self.kept())
    }

    /// When its end was seen; `None` while it lives.
    pub fn end(&self) -> Option<Instant> {
        self.kept().facts.end
    }

    /// The place of the run's one reader; `None` when it is taken, or an opening failed a
    /// moment ago.
    pub fn take_seat(self: &Arc<Self>, now: Instant) -> Option<Seat> {
        let is_free = self.change(|kept| {
            let failed = kept.failed;
            let is_due = failed.is_none_or(|at| now.since_ns(at) >= RETRY_NS);
            let is_free = is_due && !kept.is_read;
            kept.is_read |= is_free;
            is_free
        });
        is_free.then(|| Seat {
            entry: self.clone(),
            taken: now,
        })
    }

    /// Whether a reader has its place.
    pub fn is_read(&self) -> bool {
        self.kept().is_read
    }

    /// Its reader has opened it: what was known of an earlier time is forgotten.
    pub fn has_begun(&self, facts: Facts, machine: Option<Machine>) {
        self.change(|kept| {
            *kept = Kept {
                facts,
                machine,
                is_read: kept.is_read,
                ..Kept::default()
            };
        });
    }

    /// It cannot be opened.
    pub fn is_refused(&self, why: &str, now: Instant) {
        let why: String = printable(why).chars().take(NOTE_MAX).collect();
        self.hub.begin(&Hello::waiting(why.clone()).json());
        self.change(|kept| {
            let since = kept.facts.refusal.as_ref().map_or(now, |(since, _)| *since);
            (kept.facts.refusal, kept.facts.end) = (Some((since, why)), None);
            kept.failed = Some(now);
        });
    }

    /// Its supervisor has ended.
    pub fn has_ended(&self, now: Instant) {
        let name = &self.name;
        let note = format!("run '{name}' has ended; ./vlaps up --run {name} starts it again");
        self.hub.begin(&Hello::waiting(note).json());
        self.change(|kept| {
            (kept.facts.end, kept.facts.refusal) = (Some(now), None);
            kept.failed = None;
        });
    }

    /// Its card at this time.
    pub fn card(&self, now: Instant) -> Card {
        let mut kept = self.kept();
        let state = kept.facts.state(now);
        if state != State::Ended {
            kept.minute.advance(now);
        }
        let facts = &kept.facts;
        let note = match state {
            State::Refused => facts.refusal.as_ref().map(|(_, why)| why.clone()),
            State::Faulty => Some(kept.fault.clone()),
            State::Silent if facts.newest.is_none() => Some("no step has come yet".into()),
            _ => None,
        };
        let since = facts.end.or(facts.newest);
        Card {
            name: self.name.to_string(),
            state,
            note: note.unwrap_or_default(),
            machine: kept.machine.clone(),
            age_s: since.map(|at| rounded(now.since_ns(at) as f64 * 1e-9, 1)),
            figures: kept.figures.clone(),
            band: kept.minute.parts(),
            scene: kept.scene.clone(),
            sample: kept.sample.clone(),
        }
    }

    fn kept(&self) -> MutexGuard<'_, Kept> {
        // It is whole between two statements that change it.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The place of a run's one reader. It is free again when this is dropped.
#[derive(Debug)]
pub struct Seat {
    /// The run.
    pub entry: Arc<Entry>,
    taken: Instant,
}

impl Drop for Seat {
    fn drop(&mut self) {
        if std::thread::panicking() {
            let why = "its reader failed; the terminal of ./vlaps view has more";
            self.entry.is_refused(why, self.taken);
        }
        self.entry.change(|kept| kept.is_read = false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn entry() -> Arc<Entry> {
        Arc::new(Entry::new("a".parse().expect("a name"), Instant(0)))
    }

    #[test]
    fn a_run_has_one_reader_and_a_failed_opening_is_tried_again_later() {
        let entry = entry();
        let seat = entry.take_seat(Instant(0)).expect("it is free");
        assert!(entry.take_seat(Instant(0)).is_none() && entry.is_read());
        drop(seat);
        assert!(entry.take_seat(Instant(1)).is_some());
        entry.is_refused("why", Instant(SECOND));
        assert!(entry.take_seat(Instant(SECOND + 700_000_000)).is_none());
        assert!(entry.take_seat(Instant(2 * SECOND)).is_some());
    }

    #[test]
    fn a_reader_that_panics_leaves_its_place_and_the_card_says_so() {
        let entry = entry();
        let seat = entry.take_seat(Instant(SECOND)).expect("it is free");
        let reader = std::thread::spawn(move || {
            let _seat = seat;
            panic!("as the test wants");
        });
        assert!(reader.join().is_err());
        assert!(!entry.is_read());
        assert_eq!(entry.card(Instant(9 * SECOND)).state, State::Refused);
        assert!(entry.take_seat(Instant(9 * SECOND)).is_some());
    }

    #[test]
    fn a_card_says_why_a_run_cannot_be_opened_until_it_can() {
        let entry = entry();
        entry.is_refused("another\u{1b} layout", Instant(SECOND));
        entry.is_refused("another\u{1b} layout", Instant(4 * SECOND));
        let card = entry.card(Instant(5 * SECOND));
        assert_eq!(card.state, State::Refused);
        assert_eq!(card.note, "another\\u{1b} layout");
        assert!(entry.hub.hello().contains("layout"));
        let facts = Facts {
            opened: Instant(5 * SECOND),
            ..Facts::default()
        };
        entry.has_begun(facts, None);
        assert_eq!(entry.card(Instant(5 * SECOND)).state, State::Starting);
    }

    #[test]
    fn an_ended_run_keeps_its_figures_and_tells_how_long_ago_it_ended() {
        let entry = entry();
        entry.change(|kept| {
            kept.facts.newest = Some(Instant(SECOND));
            kept.figures.late = 3;
        });
        entry.has_ended(Instant(2 * SECOND));
        let card = entry.card(Instant(9 * SECOND));
        assert_eq!((card.state, card.age_s), (State::Ended, Some(7.0)));
        assert_eq!(card.figures.late, 3);
    }
}
