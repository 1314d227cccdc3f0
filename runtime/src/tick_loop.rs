//! The loop of every process with a fixed rate.

use std::time::Duration;

use rustix::time::{ClockId, Timespec};
use shm_config::Instant;
use shm_config::message::HealthState;
use shm_config::wire::{Doorbell, WireError};

use crate::{Member, SetUpError, Telemetry};

/// The longest that a process waits between two heartbeats.
pub const HEARTBEAT_MAX: Duration = Duration::from_millis(20);

/// Whether the loop goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    /// It goes on with the next tick.
    Continue,
    /// It ends.
    End,
}

/// What one process does at a fixed rate; [`TickLoop::run`] calls its functions.
pub trait FixedRate {
    /// What the end of a wait tells the tick.
    type Due;

    /// Called once, when everything is allocated and before the first tick.
    fn ready(&mut self, _run: &mut TickLoop) {}

    /// Connects the ports to new or restarted peers. Called between ticks: it may
    /// allocate.
    fn update_connections(&mut self);

    /// Waits for the next tick; `None` when none is due yet. Where the time of the tick
    /// is not known, it waits once, and no longer than [`HEARTBEAT_MAX`].
    fn await_tick(&mut self, run: &mut TickLoop) -> Option<Self::Due>;

    /// Runs one tick and accounts for it. It never allocates, locks, logs or blocks.
    ///
    /// # Errors
    /// An error that ends the process.
    fn tick(&mut self, run: &mut TickLoop, due: Self::Due) -> Result<Flow, SetUpError>;

    /// The process was asked to stop. Called before each wait from then on.
    fn stop(&mut self, _run: &mut TickLoop, _now: Instant) -> Flow {
        Flow::End
    }

    /// Called after the last tick.
    fn finish(&mut self, _run: &mut TickLoop) {}
}

/// A process that has joined its run; it drives a [`FixedRate`].
pub struct TickLoop {
    /// Its membership.
    pub member: Member,
    /// What it reports about itself.
    pub telemetry: Telemetry,
    bell: Doorbell,
}

impl TickLoop {
    /// Opens the doorbell and the ports of the telemetry.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn start(member: Member) -> Result<Self, WireError> {
        Ok(Self {
            bell: member.wire.doorbell(member.process)?,
            telemetry: Telemetry::start(&member)?,
            member,
        })
    }

    /// Applies the privileges and runs the process to its end.
    ///
    /// # Errors
    /// The errors of its ticks.
    pub fn run(mut self, process: &mut impl FixedRate) -> Result<(), SetUpError> {
        self.member.apply_privileges();
        self.telemetry.set_privileges(&self.member.privileges);
        self.telemetry.enter(HealthState::Ready, self.member.now());
        process.ready(&mut self);
        loop {
            let now = self.member.now();
            self.telemetry.heartbeat(now);
            process.update_connections();
            if self.member.is_stopping() && process.stop(&mut self, now) == Flow::End {
                break;
            }
            let flow = match process.await_tick(&mut self) {
                Some(due) => process.tick(&mut self, due)?,
                None => Flow::Continue,
            };
            self.telemetry.count_refused(&self.member.wire);
            if flow == Flow::End {
                break;
            }
        }
        process.finish(&mut self);
        let now = self.member.now();
        self.telemetry.enter(HealthState::Finished, now);
        Ok(())
    }

    /// The machine's clock, now.
    pub fn now(&self) -> Instant {
        self.member.now()
    }

    /// Sleeps until the doorbell rings, `until` has come, or a heartbeat is due.
    pub fn wait(&self, until: Option<Instant>, now: Instant) {
        let left = until.map_or(HEARTBEAT_MAX, |until| {
            Duration::from_nanos(until.since_ns(now))
        });
        self.bell.wait(HEARTBEAT_MAX.min(left));
    }

    /// Sleeps until this instant of the machine's clock; the doorbell does not wake it.
    pub fn sleep_until(&self, instant: Instant) {
        let instant: Timespec = instant.timespec();
        while rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &instant).is_err() {}
    }
}
