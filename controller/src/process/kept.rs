//! In lockstep with a recorder: the controller is not further ahead of it than its queues of
//! newest values hold. `docs/recording.md` says what may still be lost.

use runtime::{Member, SetUpError};
use shm_config::config::Keep;
use shm_config::services::RECORDED_DEPTH;
use shm_config::{Instant, Message};

use crate::ports::RecorderPorts;

/// How long a recorder is waited for, ns on the machine's clock. It takes seconds when the
/// disk hangs; after that the run goes on, and what is lost is counted.
const WAIT_NS: u64 = 10_000_000_000;

/// A recorder that is waited for.
pub struct RecorderWait {
    ports: RecorderPorts,
    /// The newest tick that it has read; until it has read one, the tick when it was last
    /// heard.
    newest: Option<u64>,
    /// The tick that was driven last.
    driven: Option<u64>,
    /// When the wait for it is over; set when it is first polled.
    until: Option<Instant>,
    /// Ticks that the controller may be ahead.
    ahead_max: u64,
    /// It did not answer in time; it is not waited for until it does.
    is_silent: bool,
}

impl RecorderWait {
    /// Opens what is needed; `None` where no recorder is waited for.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn open(member: &Member) -> Result<Option<Self>, SetUpError> {
        let config = &member.config;
        if !config.run.is_lockstep() || config.keeps() == Keep::Nothing {
            return Ok(None);
        }
        // The world may publish several observations in a tick, and one more has begun.
        let observations = (config.world_rate_hz() / config.run.rate_hz).max(1.0);
        Ok(Some(Self {
            ports: RecorderPorts::open(&member.wire)?,
            newest: None,
            driven: None,
            until: None,
            ahead_max: ((RECORDED_DEPTH as f64 / 2.0 / observations) as u64).max(1),
            is_silent: false,
        }))
    }

    /// A tick was driven: the next one waits for the recorder.
    pub fn end_tick(&mut self, tick: u64) {
        self.driven = Some(tick);
        self.until = None;
    }

    /// Whether the next tick has to wait until the recorder has read the steps up to a few
    /// before the last one.
    pub fn holds_tick(&mut self, now: Instant) -> bool {
        let Some(tick) = self.driven else {
            return false;
        };
        self.receive(tick);
        let newest = *self.newest.get_or_insert(tick);
        let is_behind = tick.saturating_sub(newest) > self.ahead_max;
        let until = *self.until.get_or_insert(now.after_ns(WAIT_NS));
        if is_behind && !self.is_silent && now >= until {
            self.is_silent = true;
            tracing::warn!("the recorder is silent; the run goes on without it");
        }
        is_behind && !self.is_silent
    }

    /// Connects to a recorder that came or came back.
    pub fn update_connections(&mut self) {
        self.ports.update_connections();
    }

    fn receive(&mut self, tick: u64) {
        if let Some(kept) = self.ports.kept.newest(Message::check) {
            // A recorder that was started again has read no step, and gets none of those
            // before this tick: it reads from here on.
            self.newest = Some(kept.step().unwrap_or(tick));
            self.is_silent = false;
        }
    }
}
