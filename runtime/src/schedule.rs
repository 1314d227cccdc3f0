use shm_config::Instant;
use shm_config::message::FUTURE_TOLERANCE_NS;

/// What released a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Release {
    /// An observation.
    Observation,
    /// The end of the wait for one.
    TimeOut,
}

/// One tick of the controller: the instant of the grid it is due at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slot {
    /// The instant of the grid, ns on the machine's clock.
    pub scheduled: Instant,
    /// When the tick was to begin: the instant itself, or for a tick without an
    /// observation the end of the wait for one.
    pub due: Instant,
    /// What released it.
    pub release: Release,
    /// Instants of the grid that passed without a tick before this one.
    pub skipped: u64,
}

/// The controller's side of the world's grid: at most one tick for each of its
/// instants, on a new observation or, when none came, on the grid itself.
///
/// So `elapsed / period == ticks + skipped` however late or lost observations are.
#[derive(Debug, Clone)]
pub struct Slots {
    period_ns: u64,
    wait_ns: u64,
    last: Option<Instant>,
}

impl Slots {
    /// A grid of this period; without an observation the tick comes `wait_ns`
    /// after its instant.
    pub fn new(period_ns: u64, wait_ns: u64) -> Self {
        Self {
            period_ns,
            wait_ns,
            last: None,
        }
    }

    /// When to tick at the latest, observation or not; `None` before the first
    /// observation tells where the grid is.
    pub fn deadline(&self) -> Option<Instant> {
        self.last
            .map(|last| last.after_ns(self.period_ns + self.wait_ns))
    }

    /// The slot of an observation that was due at `scheduled`; `None` when that
    /// slot has had its tick, or when it claims to be from the future: a grid
    /// moved there would silence the controller.
    pub fn on_observation(&mut self, scheduled: Instant, now: Instant) -> Option<Slot> {
        if scheduled > now.after_ns(FUTURE_TOLERANCE_NS) {
            return None;
        }
        let skipped = match self.last {
            None => 0,
            Some(last) => {
                // Another world's grid may be shifted: round to whole periods.
                let passed = (scheduled.since_ns(last) + self.period_ns / 2) / self.period_ns;
                if passed == 0 {
                    return None;
                }
                passed - 1
            }
        };
        self.last = Some(scheduled);
        Some(Slot {
            scheduled,
            due: scheduled,
            release: Release::Observation,
            skipped,
        })
    }

    /// The slot of a tick without a new observation at `now`, at or after the
    /// deadline.
    pub fn on_timeout(&mut self, now: Instant) -> Option<Slot> {
        let last = self.last?;
        let passed = now.since_ns(last.after_ns(self.wait_ns)) / self.period_ns;
        if passed == 0 {
            return None;
        }
        let scheduled = last.after_ns(passed * self.period_ns);
        self.last = Some(scheduled);
        Some(Slot {
            scheduled,
            due: scheduled.after_ns(self.wait_ns),
            release: Release::TimeOut,
            skipped: passed - 1,
        })
    }
}
