//! Threads that share the work of one call.

use std::hint::spin_loop;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};

use rayon::{ThreadPool, ThreadPoolBuilder};

/// How often a thread looks for work, or for the end of the others' work, before it sleeps,
/// about 100 us: to wake a sleeping one takes tens of microseconds, more than a learner needs
/// between two steps.
const TRIES: u32 = 4_000;

/// The caller's thread and its helpers.
pub struct Crew {
    helpers: Option<Helpers>,
}

struct Helpers {
    pool: ThreadPool,
    /// Calls so far. A change ends the wait of the helpers.
    calls: Arc<AtomicU64>,
    tries: u32,
}

impl Crew {
    /// Starts `threads` less one: the caller's is one of them.
    ///
    /// # Errors
    /// One line, if a thread cannot be started.
    pub fn new(threads: NonZeroUsize) -> Result<Crew, String> {
        let count = threads.get() - 1;
        if count == 0 {
            return Ok(Crew { helpers: None });
        }
        let pool = ThreadPoolBuilder::new()
            .num_threads(count)
            .thread_name(|index| format!("vlaps-world-{index}"))
            .build()
            .map_err(|error| format!("cannot start {count} threads: {error}"))?;
        let cores = std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
        Ok(Crew {
            helpers: Some(Helpers {
                pool,
                calls: Arc::default(),
                // Without a core for each thread, one that waits keeps another from working.
                tries: if threads.get() <= cores { TRIES } else { 0 },
            }),
        })
    }

    /// Number of threads, the caller's among them.
    pub fn threads(&self) -> usize {
        let helpers = self.helpers.as_ref();
        1 + helpers.map_or(0, |helpers| helpers.pool.current_num_threads())
    }

    /// Runs `work` once for each number below that of the threads: 0 on the caller's, the others
    /// on the helpers', of which a fast one may run several.
    pub fn run(&self, work: &(impl Fn(usize) + Sync)) {
        match &self.helpers {
            None => work(0),
            Some(helpers) => helpers.run(work),
        }
    }
}

impl Helpers {
    fn run(&self, work: &(impl Fn(usize) + Sync)) {
        let call = self.calls.fetch_add(1, Ordering::Relaxed) + 1;
        let count = self.pool.current_num_threads();
        let finished = AtomicUsize::new(0);
        self.pool.in_place_scope(|scope| {
            for thread in 1..=count {
                let finished = &finished;
                scope.spawn(move |_| {
                    work(thread);
                    let (calls, tries) = (Arc::clone(&self.calls), self.tries);
                    rayon::spawn(move || {
                        wait(tries, || calls.load(Ordering::Relaxed) != call);
                    });
                    finished.fetch_add(1, Ordering::Relaxed);
                });
            }
            work(0);
            // The end of the scope sleeps until all have finished.
            wait(self.tries, || finished.load(Ordering::Relaxed) == count);
        });
    }
}

/// Waits until `is_over`, for a while.
fn wait(tries: u32, is_over: impl Fn() -> bool) {
    for _ in 0..tries {
        if is_over() {
            return;
        }
        spin_loop();
    }
}
