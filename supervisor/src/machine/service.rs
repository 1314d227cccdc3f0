//! What a service manager is told that started the supervisor with `Type=notify`: ready,
//! alive, stopping. Without one, such as in a terminal, nothing is sent.

use std::time::Duration;

use sd_notify::NotifyState;
use shm_config::Instant;

/// How far a set is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Processes start.
    Starting,
    /// Each process was ready.
    Ready,
    /// The car is braked, the processes are stopped.
    Stopping,
}

/// The service manager. One that does not answer delays the supervisor at most, which no
/// tick waits for.
#[derive(Debug)]
pub struct ServiceManager {
    told: Stage,
    /// Time between two signs of life, ns: half of what the watchdog allows. `None` without
    /// a watchdog.
    alive_every_ns: Option<u64>,
    alive_at: Option<Instant>,
}

impl ServiceManager {
    /// The one that the environment names.
    pub fn of_environment() -> Self {
        let half = |limit: Duration| u64::try_from(limit.as_nanos() / 2).unwrap_or(u64::MAX);
        Self {
            told: Stage::Starting,
            alive_every_ns: sd_notify::watchdog_enabled().map(half),
            alive_at: None,
        }
    }

    /// Tells it a new stage, and that the supervisor's loop goes round.
    pub fn tell(&mut self, stage: Stage, now: Instant) {
        if stage != self.told {
            self.told = stage;
            match stage {
                Stage::Starting => {}
                Stage::Ready => send(&[NotifyState::Ready, NotifyState::Status("driving")]),
                Stage::Stopping => send(&[
                    NotifyState::Stopping,
                    NotifyState::Status("braking, then stopping the processes"),
                ]),
            }
        }
        let Some(every_ns) = self.alive_every_ns else {
            return;
        };
        let is_due = |at: Instant| now.since_ns(at) >= every_ns;
        if self.alive_at.is_none_or(is_due) {
            self.alive_at = Some(now);
            send(&[NotifyState::Watchdog]);
        }
    }
}

/// A manager that is gone or refuses cannot be told so, and the set drives on.
fn send(states: &[NotifyState<'_>]) {
    let _ = sd_notify::notify(states);
}
