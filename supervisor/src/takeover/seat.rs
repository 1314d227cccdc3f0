//! The person's seat: keys become words to the controller.

use std::path::Path;

use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{Header, Takeover};
use shm_config::wire::Publisher;

use crate::cli::failure::Failure;
use crate::takeover::driver::Person;
use crate::takeover::keyboard::Keyboard;
use crate::takeover::script::Script;
use crate::telemetry::tally::Tally;

/// Where the keys come from.
#[derive(Debug)]
pub enum Keys {
    /// A person at this terminal.
    Terminal(Keyboard),
    /// A file.
    Script(Script),
}

impl Keys {
    /// The keys of a run; `None` when nobody may take over.
    ///
    /// # Errors
    /// When somebody may, and neither the terminal nor the file has keys; or there
    /// is a file and nobody may.
    pub fn of(config: &Config, file: Option<&Path>) -> Result<Option<Self>, Failure> {
        match (config.gate.mode, file) {
            (GateMode::Human, Some(path)) => Ok(Some(Self::Script(Script::read(path)?))),
            (GateMode::Human, None) => Ok(Some(Self::Terminal(Keyboard::open()?))),
            (_, None) => Ok(None),
            (_, Some(path)) => Err(Failure::Usage(format!(
                "--keys {}: nobody can take over with this gate; add --gate human",
                path.display()
            ))),
        }
    }
}

/// Keys, what they amount to, and who hears of it.
pub struct Seat {
    keys: Keys,
    person: Person,
    port: Publisher<Takeover>,
}

impl Seat {
    /// Nobody has taken over yet.
    pub fn new(keys: Keys, port: Publisher<Takeover>) -> Self {
        Self {
            keys,
            person: Person::default(),
            port,
        }
    }

    /// Reads the keys and says what they amount to, to be called at 20 Hz. Never
    /// waits. Returns what has changed, for the journal.
    pub fn tend(&mut self, tally: &Tally, now: Instant) -> Option<&'static str> {
        let before = self.person.has_taken_over();
        match (&mut self.keys, tally.steps.begun) {
            (Keys::Terminal(keyboard), _) => {
                for key in keyboard.read() {
                    self.person.press(key, now);
                }
            }
            // At its own time, not that of the look: the same file steers the same.
            (Keys::Script(script), Some(begun)) => {
                while let Some((time_ns, key)) = script.due(now.since_ns(begun)) {
                    self.person.press(key, begun.after_ns(time_ns));
                }
            }
            (Keys::Script(_), None) => {}
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
            (Keys::Script(_), _) => None,
            (Keys::Terminal(_), false) => Some("keys: Space takes over".into()),
            (Keys::Terminal(_), true) => {
                let Takeover { steer, pedal, .. } = self.person.takeover();
                Some(format!(
                    "keys: arrows or WASD drive, Space, Esc or q gives back; \
                     steer {steer:+.2}, pedal {pedal:+.2}"
                ))
            }
        }
    }
}
