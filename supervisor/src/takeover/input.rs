//! The input of a human driver: keys become takeover messages to the controller.

use std::path::Path;

use shm_config::Instant;
use shm_config::config::{Config, GateMode};
use shm_config::message::{Header, Takeover};
use shm_config::services::TAKEOVER;

use crate::cli::failure::Failure;
use crate::takeover::driver::HumanDriver;
use crate::takeover::keyboard::Keyboard;
use crate::takeover::script::KeyScript;
use crate::telemetry::tally::Tally;

/// Where the keys come from.
#[derive(Debug)]
pub enum KeySource {
    /// This terminal.
    Terminal(Keyboard),
    /// A file.
    Script(KeyScript),
}

impl KeySource {
    /// The key source of a run; `None` when its gate allows no takeover.
    ///
    /// # Errors
    /// When neither the terminal nor the file has keys, or a file is given although the gate
    /// allows no takeover.
    pub fn of(config: &Config, file: Option<&Path>) -> Result<Option<Self>, Failure> {
        match (config.gate.mode, file) {
            (GateMode::Human, Some(path)) => Ok(Some(Self::Script(KeyScript::read(path)?))),
            (GateMode::Human, None) => Ok(Some(Self::Terminal(Keyboard::open()?))),
            (_, None) => Ok(None),
            (_, Some(path)) => Err(Failure::Usage(format!(
                "--keys {}: this gate allows no takeover; add --gate human",
                path.display()
            ))),
        }
    }
}

shm_config::ports! {
    /// Where a human driver's wishes go.
    pub struct TakeoverPorts of Supervisor {
        /// To the controller.
        takeovers: write TAKEOVER: Takeover,
    }
}

/// The input of a run: the key source, the driver's action, and the port.
pub struct TakeoverInput {
    keys: KeySource,
    person: HumanDriver,
    ports: TakeoverPorts,
}

impl TakeoverInput {
    /// The input before any takeover.
    pub fn new(keys: KeySource, ports: TakeoverPorts) -> Self {
        Self {
            keys,
            person: HumanDriver::default(),
            ports,
        }
    }

    /// Reads the keys and publishes the takeover message; call it at 20 Hz. Never blocks.
    /// Returns a change for the journal.
    pub fn publish(&mut self, tally: &Tally, now: Instant) -> Option<&'static str> {
        let before = self.person.has_taken_over();
        match (&mut self.keys, tally.steps.begun) {
            (KeySource::Terminal(keyboard), _) => {
                for key in keyboard.read() {
                    self.person.press(key, now);
                }
            }
            // At the time of the line, not of this call: the same file gives the same action.
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
        self.ports.takeovers.update_connections();
        // When shared memory is full, the last message expires and the takeover ends.
        self.ports.takeovers.send(&mut takeover);
        match (before, self.person.has_taken_over()) {
            (false, true) => Some("the human driver took over"),
            (true, false) => Some("the human driver gave back"),
            (false, false) | (true, true) => None,
        }
    }

    /// The effect of the keys now, for the screen; `None` for keys of a file.
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
