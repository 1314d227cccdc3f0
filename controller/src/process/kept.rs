//! In lockstep with a recorder: the controller is not further ahead of it than its queues of
//! newest values hold. `docs/recording.md` says what may still be lost.

use runtime::{Member, SetUpError, TickLoop};
use shm_config::Message;
use shm_config::config::Keep;
use shm_config::services::RECORDED_DEPTH;

use crate::ports::RecorderPorts;

/// Interval at which the recorder is polled, ns: its message wakes the controller before.
const POLL_NS: u64 = 2_000_000;
/// How long a recorder is waited for, ns on the machine's clock. It takes seconds when the
/// disk hangs; after that the run goes on, and what is lost is counted.
const WAIT_NS: u64 = 10_000_000_000;

/// A recorder that is waited for.
pub struct RecorderWait {
    ports: RecorderPorts,
    /// The newest tick that it has read; until it has read one, the tick when it was last
    /// heard.
    newest: Option<u64>,
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
            ahead_max: ((RECORDED_DEPTH as f64 / 2.0 / observations) as u64).max(1),
            is_silent: false,
        }))
    }

    /// Waits until the recorder has read the steps up to a few before this tick's.
    pub fn wait(&mut self, run: &mut TickLoop, tick: u64) {
        self.newest.get_or_insert(tick);
        self.receive(tick);
        let until = run.now().after_ns(WAIT_NS);
        while self.is_behind(tick) && !self.is_silent && !run.member.is_stopping() {
            let now = run.now();
            if now >= until {
                self.is_silent = true;
                tracing::warn!("the recorder is silent; the run goes on without it");
                break;
            }
            run.wait_alive(until.min(now.after_ns(POLL_NS)), now);
            self.update_connections();
            self.receive(tick);
        }
    }

    fn is_behind(&self, tick: u64) -> bool {
        let newest = self.newest.unwrap_or(tick);
        tick.saturating_sub(newest) > self.ahead_max
    }

    /// Connects to a recorder that came or came back.
    pub fn update_connections(&mut self) {
        self.ports.update_connections();
    }

    fn receive(&mut self, tick: u64) {
        if let Some(kept) = self.ports.kept.newest(Message::check) {
            self.newest = Some(match kept.header.tick {
                // A recorder that was started again has read no step, and gets none of
                // those before this tick: it reads from here on.
                0 => tick,
                read => read,
            });
            self.is_silent = false;
        }
    }
}
