//! Tests of a run's place beside processes that observe the run.

use std::fs::{self, File};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;

use shm_config::run::{RunLock, RunName, RunPaths};
use supervisor::run::leftovers::clean_run;
use supervisor::run::place::Place;

/// Sets that take the place one after another.
const SETS: u32 = 20;
/// Threads that look at the run all the time, and threads that also join it.
const LOOKERS: usize = 3;
const JOINERS: usize = 2;
/// Looks that the slowest observer of a lock outlasts: a few milliseconds.
const SLOW_LOOKS: u32 = 20;
/// Looks at a place that is held and cannot be clean yet.
const LOOKS: u32 = 50;

/// A run, and what the threads of a test tell each other.
struct Observed {
    paths: RunPaths,
    /// Sets so far. A file of an earlier set lies in the place when this is counted up.
    sets: AtomicU32,
    /// Looks while that file lay there, and those of them that found the place held.
    looks: AtomicU32,
    held_looks: AtomicU32,
    /// The number of the last set that a process joined.
    joined: AtomicU32,
    is_over: AtomicBool,
}

impl Observed {
    fn new(name: &RunName) -> Self {
        Self {
            paths: RunPaths::new(name.clone()),
            sets: AtomicU32::new(0),
            looks: AtomicU32::new(0),
            held_looks: AtomicU32::new(0),
            joined: AtomicU32::new(0),
            is_over: AtomicBool::new(false),
        }
    }

    fn leftover(&self) -> PathBuf {
        self.paths.dir().join("config.toml")
    }

    /// Leaves what a killed set leaves, whose last process still ends.
    fn leave(&self) -> RunLock {
        let alive = loop {
            // An observer may be cleaning the place.
            if let Ok(alive) = self.paths.hold_alive() {
                break alive;
            }
        };
        fs::write(self.leftover(), "").expect("a leftover");
        fs::write(self.paths.dir().join("opened"), "1 1\n").expect("its marker");
        self.looks.store(0, Ordering::SeqCst);
        self.held_looks.store(0, Ordering::SeqCst);
        self.sets.fetch_add(1, Ordering::SeqCst);
        alive
    }

    /// Looks whether the supervisor's lock is free, as an observer that is slow to let go.
    fn probe(&self) -> File {
        let mut options = File::options();
        let options = options.create(true).truncate(false).write(true).mode(0o600);
        let file = options.open(self.paths.supervisor_file());
        let file = file.expect("the supervisor's file");
        file.lock_shared().expect("a lock");
        file
    }

    /// Looks at the run, and at its place before and after.
    fn look(&self) {
        let place = || {
            let set = self.sets.load(Ordering::SeqCst);
            (set, self.leftover().exists())
        };
        let before = place();
        let seen = self.paths.supervisor_pid();
        let is_held = self.paths.holder().expect("a place of ours").is_some();
        if before == (before.0, true) && place() == before {
            assert_eq!(seen, None, "set {} cleans its place", before.0);
            self.looks.fetch_add(1, Ordering::SeqCst);
            self.held_looks
                .fetch_add(u32::from(is_held), Ordering::SeqCst);
        }
        assert!(seen.is_none_or(|pid| pid == std::process::id()), "{seen:?}");
    }

    /// Joins the run as a view does, and leaves it at its end.
    fn join(&self) {
        let Some(supervisor) = self.paths.supervisor_pid() else {
            return;
        };
        // It may be cleaned since.
        let Ok(alive) = self.paths.hold_alive() else {
            return;
        };
        while self.paths.supervisor_pid() == Some(supervisor) {
            let set = self.sets.load(Ordering::SeqCst);
            self.joined.fetch_max(set, Ordering::SeqCst);
        }
        drop(alive);
        clean_run(&self.paths).expect("a place that can be cleaned");
    }

    fn until_over(&self, turn: impl Fn(&Self)) {
        while !self.is_over.load(Ordering::SeqCst) {
            turn(self);
        }
    }

    fn until(&self, condition: impl Fn() -> bool) {
        while !condition() && !self.is_over.load(Ordering::SeqCst) {
            thread::yield_now();
        }
    }
}

/// Ends the observers, also when the test fails.
struct Over<'a>(&'a AtomicBool);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// A set that starts while observers look at its run, join it and clean up after it has its
/// place to itself until it is clean, and no observer keeps it from being taken or removed.
#[test]
fn no_observer_keeps_a_place_from_being_taken() {
    let name: RunName = format!("p{}", std::process::id()).parse().expect("a name");
    let run = Observed::new(&name);
    let run = &run;
    let over = || Over(&run.is_over);
    thread::scope(|threads| {
        let _over = over();
        for _ in 0..LOOKERS {
            threads.spawn(|| {
                let _over = over();
                run.until_over(Observed::look);
            });
        }
        for _ in 0..JOINERS {
            threads.spawn(|| {
                let _over = over();
                run.until_over(Observed::join);
            });
        }
        let mut cleaned = 0;
        for set in 1..=SETS {
            let alive = run.leave();
            let probe = run.probe();
            // The last process of the killed set ends after some looks.
            threads.spawn(move || {
                run.until(|| run.looks.load(Ordering::SeqCst) >= SLOW_LOOKS);
                drop(probe);
                run.until(|| run.held_looks.load(Ordering::SeqCst) >= LOOKS);
                drop(alive);
            });
            let (place, leftovers) = Place::take(name.clone())
                .unwrap_or_else(|failure| panic!("set {set} of {SETS}: {failure}"));
            cleaned += leftovers.files;
            let pid = run.paths.supervisor_pid();
            assert_eq!(pid, Some(std::process::id()), "set {set} is up");
            let own = run.paths.dir().join("own");
            fs::write(&own, "").expect("a file of the set");
            run.until(|| run.joined.load(Ordering::SeqCst) == set);
            assert!(!run.is_over.load(Ordering::SeqCst), "an observer failed");
            drop(place);
            assert!(!own.exists(), "set {set}: an observer keeps its files");
        }
        // An observer may have cleaned some places first.
        assert!(cleaned > 0, "no set has cleaned its place");
    });
    clean_run(&run.paths).expect("a clean place");
}
