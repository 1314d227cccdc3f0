//! The instants at which the ticks of one process are due, and which of them were
//! skipped.

use shm_config::Instant;
use shm_config::message::{FUTURE_TOLERANCE_NS, Health};

use crate::Skipped;

/// What released a tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Release {
    /// An observation.
    Observation,
    /// The end of the wait for an observation.
    TimeOut,
}

/// One tick that is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DueTick {
    /// Its instant on the grid, on the machine's clock.
    pub scheduled: Instant,
    /// When the tick was to begin: the instant itself or, for a tick without an
    /// observation, the end of the wait for one.
    pub due: Instant,
    /// What released it.
    pub release: Release,
    /// Instants of the grid that passed without a tick just before this one.
    pub skipped: u64,
}

/// The grid of a process: at most one tick for each instant.
///
/// The world moves on its own timer ([`TickSchedule::on_timer`]); planner and
/// controller follow the instants of the observations. In both cases
/// `elapsed / period == ticks + skipped`, however late or lost a tick is.
#[derive(Debug, Clone)]
pub struct TickSchedule {
    period_ns: u64,
    /// Instants in one tick: the world may move several times in each tick of the run.
    parts: u64,
    /// `None` until the first observation fixes the phase of the grid.
    first: Option<Instant>,
    /// When the present or next tick begins.
    next: Instant,
    /// Instants of that tick that have passed.
    part: u64,
    /// Ticks of the grid that have passed.
    passed: u64,
    ticks: u64,
    missed: u64,
}

impl TickSchedule {
    /// A grid of this period whose phase the first observation fixes.
    pub fn following(period_ns: u64) -> Self {
        Self {
            period_ns,
            parts: 1,
            first: None,
            next: Instant(0),
            part: 0,
            passed: 0,
            ticks: 0,
            missed: 0,
        }
    }

    /// A grid of this period with `parts` instants in a tick, the first of them at
    /// `first`.
    pub fn on_timer(period_ns: u64, parts: u64, first: Instant) -> Self {
        Self {
            parts,
            first: Some(first),
            next: first,
            ..Self::following(period_ns)
        }
    }

    /// Time from tick to tick, ns.
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// Ticks that were begun.
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Instants that passed without a tick.
    pub fn skipped(&self) -> u64 {
        self.ticks_due().saturating_sub(self.ticks)
    }

    /// The instant of the next tick; 0 before the phase is known.
    pub fn next(&self) -> Instant {
        match self.part {
            0 => self.next,
            _ => self.next.after_ns(self.period_ns),
        }
    }

    /// Writes the counts of ticks and skipped instants.
    pub fn report(&self, health: &mut Health) {
        health.ticks = self.ticks;
        health.skipped = self.skipped();
        health.first_scheduled_ns = self.first.unwrap_or_default().0;
        health.next_scheduled_ns = self.next().0;
    }

    /// The instants skipped just before a tick at this instant.
    pub fn skipped_before(&self, scheduled: Instant, count: u64) -> Skipped {
        Skipped {
            newest: Instant(scheduled.0.saturating_sub(self.period_ns)),
            period_ns: self.period_ns,
            count,
        }
    }
}

/// A grid that follows observations.
impl TickSchedule {
    /// Counts the tick of this instant and returns how many instants were skipped since
    /// the tick before. Another world's grid may be shifted, so the number of periods
    /// is rounded.
    pub fn take(&mut self, scheduled: Instant) -> u64 {
        let skipped = match self.first {
            None => 0,
            Some(_) => self.rounded(scheduled).saturating_sub(self.next.0) / self.period_ns,
        };
        self.first.get_or_insert(scheduled);
        self.next = scheduled.after_ns(self.period_ns);
        self.passed += skipped + 1;
        self.ticks += 1;
        skipped
    }

    fn rounded(&self, scheduled: Instant) -> u64 {
        scheduled.0.saturating_add(self.period_ns / 2)
    }

    /// The latest instant for the next tick when each observation is awaited for
    /// `wait_ns`; `None` before the first observation.
    pub fn deadline(&self, wait_ns: u64) -> Option<Instant> {
        self.first.map(|_| self.next.after_ns(wait_ns))
    }

    /// The tick of an observation that was due at `scheduled`. `None` when that instant
    /// has had its tick, or when it lies in the future: a grid moved there would
    /// silence the process.
    pub fn on_observation(&mut self, scheduled: Instant, now: Instant) -> Option<DueTick> {
        let has_ticked = self.first.is_some() && self.rounded(scheduled) < self.next.0;
        if has_ticked || scheduled > now.after_ns(FUTURE_TOLERANCE_NS) {
            return None;
        }
        Some(DueTick {
            scheduled,
            due: scheduled,
            release: Release::Observation,
            skipped: self.take(scheduled),
        })
    }

    /// The tick at `now` without an observation; `None` before the deadline.
    pub fn on_timeout(&mut self, now: Instant, wait_ns: u64) -> Option<DueTick> {
        let deadline = self.deadline(wait_ns).filter(|deadline| now >= *deadline)?;
        let over = now.since_ns(deadline) / self.period_ns;
        let scheduled = self.next.after_ns(over * self.period_ns);
        Some(DueTick {
            scheduled,
            due: scheduled.after_ns(wait_ns),
            release: Release::TimeOut,
            skipped: self.take(scheduled),
        })
    }
}

/// A grid on a timer.
impl TickSchedule {
    /// When the present or next instant is due.
    pub fn now(&self) -> Instant {
        self.next.after_ns(self.part * self.period_ns / self.parts)
    }

    /// When the instant before it was due.
    pub fn previous(&self) -> Instant {
        Instant(self.now().0.saturating_sub(self.step_ns()))
    }

    /// Time from instant to instant, ns; one more where the period divides unevenly.
    pub fn step_ns(&self) -> u64 {
        self.period_ns / self.parts
    }

    /// Instants that have passed.
    pub fn index(&self) -> u64 {
        self.passed * self.parts + self.part
    }

    /// The number of the present tick of the run.
    pub fn tick(&self) -> u64 {
        self.passed
    }

    /// When the present tick was due.
    pub fn scheduled(&self) -> Instant {
        self.next
    }

    /// Ticks of the run that were due before the present one.
    pub fn ticks_due(&self) -> u64 {
        self.passed + u64::from(self.part > 0)
    }

    /// Instants missed.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// Time since the first instant, ns.
    pub fn elapsed_ns(&self, now: Instant) -> u64 {
        self.first.map_or(0, |first| now.since_ns(first))
    }

    /// Begins the present tick.
    pub fn begin(&mut self) {
        self.ticks += 1;
    }

    /// Ends the present instant.
    pub fn move_on(&mut self) {
        self.pass(1);
    }

    /// Accounts for a late wake-up: the newest instant that was due becomes the present
    /// one, and those before it are missed. Returns how many.
    pub fn miss_until(&mut self, now: Instant) -> u64 {
        let missed = now.since_ns(self.now()) * self.parts / self.period_ns;
        self.missed += missed;
        self.pass(missed);
        missed
    }

    fn pass(&mut self, instants: u64) {
        self.part += instants;
        let ticks = self.part / self.parts;
        self.passed += ticks;
        self.next = self.next.after_ns(ticks * self.period_ns);
        self.part %= self.parts;
    }
}
