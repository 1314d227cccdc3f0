//! The person's seat: keys become words to the controller.

use std::path::Path;

use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{Header, Takeover};
use shm_config::wire::Publisher;

use crate::cli::failure::Failure;
use crate::takeover::driver::HumanDriver;
use crate::takeover::keyboard::Keyboard;
use crate::takeover::script::KeyScript;
use crate::telemetry::tally::Tally;

/// Where the keys come from.
#[derive(Debug)]
pub enum KeySource {
    /// A person at this terminal.
    Terminal(Keyboard),
    /// A file.
    Script(KeyScript),
}

impl KeySource {
    /// The keys of a run; `None` when nobody may take over.
    ///
    /// # Errors
    /// When somebody may, and neither the terminal nor the file has keys; or there
    /// is a file and nobody may.
    pub fn of(config: &Config, file: Option<&Path>) -> Result<Option<Self>, Failure> {
        match (config.gate.mode, file) {
            (GateMode::Human, Some(path)) => Ok(Some(Self::Script(KeyScript::read(path)?))),
            (GateMode::Human, None) => Ok(Some(Self::Terminal(Keyboard::open()?))),
            (_, None) => Ok(None),
            (_, Some(path)) => Err(Failure::Usage(format!(
                "--keys {}: nobody can take over with this gate; add --gate human",
                path.display()
            ))),
        }
    }
}

/// KeySource, what they amount to, and who hears of it.
pub struct TakeoverInput {
    keys: KeySource,
    person: HumanDriver,
    port: Publisher<Takeover>,
}

impl TakeoverInput {
    /// Nobody has taken over yet.
    pub fn new(keys: KeySource, port: Publisher<Takeover>) -> Self {
        Self {
            keys,
            person: HumanDriver::default(),
            port,
        }
    }

    /// Reads the keys and says what they amount to, to be called at 20 Hz. Never
    /// waits. Returns what has changed, for the journal.
    pub fn publish(&mut self, tally: &Tally, now: Instant) -> Option<&'static str> {
        let before = self.person.has_taken_over();
        match (&mut self.keys, tally.steps.begun) {
            (KeySource::Terminal(keyboard), _) => {
                for key in keyboard.read() {
                    self.person.press(key, now);
                }
            }
            // At its own time, not that of the look: the same file steers the same.
            (KeySource::Script(script), Some(begun)) => {
                while let Some((time_ns, key)) = script.due(now.since_ns(begun)) {
                    self.person.press(key, begun.after_ns(time_ns));
                }
            }
            (KeySource::Script(_), None) => {}
        }
        self.person.advance(now);
        let (tick, episode) = tally.progress.map_or((0, 0), |progress| {
            (progress.header.tick, progress.header.episode)
        });
        let mut takeover = Takeover {
            header: Header {
                tick,
                taken_ns: now.0,
                episode,
                ..Header::default()
            },
            ..self.person.takeover()
        };
        self.port.tend();
        // When shared memory has no room, the last word gets old: nobody took over.
        self.port.send(&mut takeover);
        match (before, self.person.has_taken_over()) {
            (false, true) => Some("the person took over"),
            (true, false) => Some("the person gave back"),
            (false, false) | (true, true) => None,
        }
    }

    /// What the keys do now, for who sits there; `None` of a file's keys.
    pub fn help(&self) -> Option<String> {
        match (&self.keys, self.person.has_taken_over()) {
            (KeySource::Script(_), _) => None,
            (KeySource::Terminal(_), false) => Some("keys: Space takes over".into()),
            (KeySource::Terminal(_), true) => {
                let Takeover { steer, pedal, .. } = self.person.takeover();
                Some(format!(
                    "keys: arrows or WASD drive, Space, Esc or q gives back; \
                     steer {steer:+.2}, pedal {pedal:+.2}"
                ))
            }
        }
    }
}
