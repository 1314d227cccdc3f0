//! Finds the runs of the user, gives each a reader while a page wants it, and publishes
//! the cards. Without a page it does neither.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use shm_config::Instant;
use shm_config::run::RunPaths;
use shm_config::text::printable;
use supervisor::machine::signals::pause;
use supervisor::run::selection::alive;

use super::entry::Entry;
use super::reader::read;
use super::{Fleet, LET_GO_NS};
use crate::live::hub::Moment;
use crate::live::reader::STACK_BYTES;

/// Time between two looks for runs and pages.
const TURN: Duration = Duration::from_millis(250);
/// Looks between two publications of the cards: two a second.
const PUBLISH_TURNS: u64 = 2;

/// Watches until it is told to stop.
pub fn watch(fleet: &Arc<Fleet>, stop: &Arc<AtomicBool>) {
    let mut readers: Vec<JoinHandle<()>> = Vec::new();
    let mut wanted: Option<Instant> = None;
    for turn in 0_u64.. {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        let now = fleet.now();
        if fleet.hub.clients() > 0 {
            wanted = Some(now);
        }
        let is_wanted = wanted.is_some_and(|at| now.since_ns(at) <= LET_GO_NS);
        let (left_out, note) = match is_wanted {
            true => fleet.find(now),
            false => (0, String::new()),
        };
        for entry in fleet.all() {
            let is_due = is_wanted || entry.hub.clients() > 0;
            readers.extend(is_due.then(|| start(fleet, &entry, stop)).flatten());
        }
        if is_wanted && turn.is_multiple_of(PUBLISH_TURNS) {
            fleet.hub.publish(Moment {
                status: Some(fleet.cards(left_out, note)),
                ..Moment::default()
            });
        }
        for ended in readers.extract_if(.., |reader| reader.is_finished()) {
            // It panicked, and said so.
            let _ = ended.join();
        }
        pause(TURN);
    }
    for reader in readers {
        let _ = reader.join();
    }
}

impl Fleet {
    /// Gives the living runs a card; how many have none, and why the runs cannot be listed.
    fn find(&self, now: Instant) -> (usize, String) {
        self.forget(now);
        match alive() {
            Ok(living) => {
                let added = living.iter().map(|paths| self.add(paths.name()));
                (added.filter(Option::is_none).count(), String::new())
            }
            Err(failure) => (0, printable(&failure.to_string()).into_owned()),
        }
    }
}

/// Starts the reader of a run that lives and has none.
fn start(fleet: &Arc<Fleet>, entry: &Arc<Entry>, stop: &Arc<AtomicBool>) -> Option<JoinHandle<()>> {
    let now = fleet.now();
    let paths = RunPaths::new(entry.name.clone());
    if paths.supervisor_pid().is_none() {
        // Its reader was closed before its end.
        if !entry.is_read() && entry.end().is_none() {
            entry.has_ended(now);
        }
        return None;
    }
    let seat = entry.take_seat(now)?;
    let (fleet, stop) = (fleet.clone(), stop.clone());
    let started = std::thread::Builder::new()
        .name("view-reader".into())
        .stack_size(STACK_BYTES)
        .spawn(move || read(&fleet, &seat.entry, &stop));
    match started {
        Ok(reader) => Some(reader),
        Err(error) => {
            entry.is_refused(&format!("the reader's thread: {error}"), now);
            None
        }
    }
}
