//! Reads one run: twice a second for its card, and 20 times a second for its page while
//! one is open. It is one reader of the run's services, without priority, and no publisher
//! waits for it.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use shm_config::Instant;
use shm_config::run::RunPaths;
use supervisor::cli::failure::Failure;
use supervisor::machine::signals::pause;
use supervisor::run::leftovers::clean_run;
use supervisor::run::restarts;
use supervisor::show::view::View;

use super::entry::Entry;
use super::machine::Machine;
use super::state::Facts;
use super::{Fleet, LET_GO_NS};
use crate::live::events::Kind;
use crate::live::hello::Hello;
use crate::live::hub::Moment;
use crate::live::reader::{LOOK, Live, STATUS_LOOKS};
use crate::live::scene::rounded;

/// Time between two reads for the card alone: a queue of 2,048 steps then holds 8,000 a
/// second.
const CARD_LOOK: Duration = Duration::from_millis(250);
/// Time between two cards, ns: a little less than two looks.
const CARD_NS: u64 = 450_000_000;
/// Time between two looks whether the supervisor lives, ns: well within the two seconds
/// for which a new supervisor waits for the readers of the old run.
const ALIVE_NS: u64 = 200_000_000;

/// Reads a run until it ends, no page wants it, or `stop` is set.
pub fn read(fleet: &Fleet, entry: &Entry, stop: &AtomicBool) {
    let paths = RunPaths::new(entry.name.clone());
    let Some(supervisor) = paths.supervisor_pid() else {
        return;
    };
    let followed = follow(fleet, entry, (&paths, supervisor), stop);
    if let Err(failure) = followed {
        entry.is_refused(&failure.to_string(), fleet.now());
    }
    if paths.supervisor_pid().is_none() {
        entry.has_ended(fleet.now());
        // This process has kept its files from removal.
        let _ = clean_run(&paths);
    }
}

fn follow(
    fleet: &Fleet,
    entry: &Entry,
    (paths, supervisor): (&RunPaths, u32),
    stop: &AtomicBool,
) -> Result<(), Failure> {
    let mut live = Live::open(paths, supervisor)?;
    let hello = Hello::live(&live.config, supervisor).json();
    let mut reading = Reading::begin(fleet.now(), entry, &live, supervisor);
    entry.hub.begin(&hello);
    let (mut wanted, mut alive, mut page) = (fleet.now(), fleet.now(), None);
    let mut was_paged = false;
    while !stop.load(Ordering::Relaxed) {
        let now = fleet.now();
        if now.since_ns(alive) >= ALIVE_NS {
            alive = now;
            if paths.supervisor_pid() != Some(supervisor) {
                break;
            }
        }
        let is_paged = entry.hub.clients() > 0;
        if is_paged || fleet.hub.clients() > 0 {
            wanted = now;
        }
        if now.since_ns(wanted) > LET_GO_NS {
            break;
        }
        if is_paged && !was_paged {
            live.begin_course();
        }
        was_paged = is_paged;
        live.drain();
        if is_paged || now.since_ns(reading.told) >= CARD_NS {
            let looks = page.map_or(0, |(looks, _): (u64, Instant)| looks);
            let is_due = is_paged && looks.is_multiple_of(STATUS_LOOKS);
            let moment = reading.look(&mut live, is_due, now);
            if is_paged {
                page = Some((looks + 1, now));
                entry.hub.publish(moment);
            }
        }
        if page.is_some_and(|(_, seen)| now.since_ns(seen) > LET_GO_NS) {
            // What was kept for the page is forgotten.
            page = None;
            entry.hub.begin(&hello);
        }
        pause(if is_paged { LOOK } else { CARD_LOOK });
    }
    Ok(())
}

/// A run that is being read for its card.
struct Reading<'a> {
    entry: &'a Entry,
    paths: RunPaths,
    supervisor: u32,
    begun: Instant,
    /// When the card was last written.
    told: Instant,
}

impl<'a> Reading<'a> {
    fn begin(now: Instant, entry: &'a Entry, live: &Live<'_>, supervisor: u32) -> Self {
        let facts = Facts {
            opened: now,
            period_ns: (1e9 / live.config.run.rate_hz) as u64,
            ..Facts::default()
        };
        entry.has_begun(facts, machine(live, supervisor));
        let footprint = live.config.vehicle.footprint();
        entry.change(|kept| {
            kept.figures.car_m = [footprint.length_m, footprint.width_m];
        });
        Self {
            entry,
            paths: RunPaths::new(entry.name.clone()),
            supervisor,
            begun: now,
            told: Instant(0),
        }
    }

    /// Writes what is new onto the card, and returns it for the page.
    fn look(&mut self, live: &mut Live<'_>, status_due: bool, now: Instant) -> Moment {
        let is_new = live.is_new;
        let sample = live.history.open().cloned();
        let moment = live.moment(status_due);
        self.entry.change(|kept| {
            let mut is_marked = false;
            for event in &moment.events {
                is_marked |= kept.figures.counts.add(event);
                if event.kind == Kind::Fault {
                    kept.facts.fault = Some(now);
                    kept.fault.clone_from(&event.text);
                }
            }
            if is_new {
                kept.facts.newest = Some(now);
            }
            kept.minute.add(sample.as_ref(), is_marked, now);
            if let Some((_, scene)) = &moment.scene {
                kept.scene = scene.as_str().into();
            }
            if let Some(sample) = &moment.sample {
                kept.sample = sample.as_str().into();
            }
        });
        if now.since_ns(self.told) >= CARD_NS {
            self.told = now;
            self.figures(live, now);
        }
        moment
    }

    fn figures(&self, live: &Live<'_>, now: Instant) {
        let view = View::from_outside(&live.config, &live.tally, &restarts::read(&self.paths));
        let machine = machine(live, self.supervisor);
        self.entry.change(|kept| {
            let (skipped, is_first) = (kept.figures.skipped, kept.figures.clock.is_empty());
            let before = std::mem::take(&mut kept.figures.restarts);
            kept.figures.take(view);
            kept.figures.read_s = rounded(now.since_ns(self.begun) as f64 * 1e-9, 0);
            kept.machine = machine;
            // What was counted before the reading began is no news.
            if is_first {
                return;
            }
            if kept.figures.skipped > skipped {
                kept.facts.rising = Some(now);
            }
            let restarts = &kept.figures.restarts;
            if let Some((process, _)) = restarts.iter().find(|row| !before.contains(row)) {
                kept.facts.fault = Some(now);
                kept.fault = format!("{process} was restarted");
            }
        });
    }
}

/// The machine that a run comes from.
fn machine(live: &Live<'_>, supervisor: u32) -> Option<Machine> {
    Machine::of(supervisor, Path::new(&live.config.run.folder))
}
