//! One episode of a block, driven with the block's policy.

use std::ops::ControlFlow;

use controller::Policy;
use shm_config::Instant;
use shm_config::config::{Clock as RunClock, Config, GateMode, Simulator};
use shm_config::message::{Header, Observation, Step};
use supervisor::cli::failure::Failure;

use super::message::EpisodeKey;
use crate::fork::drive::{Drive, Start, Wheel};
use crate::replay::rebuild::{Mover, observe};

/// Drives episodes of one training.
pub struct Episodes {
    config: Config,
    mover: Mover,
}

/// A clock that stands still: the result must not depend on the machine's speed.
fn still() -> Instant {
    Instant(0)
}

/// The configuration with which actors and learner of a training work.
///
/// # Errors
/// When the configured world or judge has a process of its own, which an actor has not.
pub fn in_lockstep(config: &Config) -> Result<Config, Failure> {
    let refused = |what: String| {
        Err(Failure::Usage(format!(
            "--actors: {what}; ./vlaps train without --actors trains with it"
        )))
    };
    if config.world.simulator != Simulator::BuiltIn {
        let world = config.world.simulator.word();
        return refused(format!(
            "an actor drives in the built-in world, not in {world}"
        ));
    }
    match config.gate.mode {
        GateMode::Expert | GateMode::Policy | GateMode::Takeover | GateMode::Rules => {}
        GateMode::Human
        | GateMode::Vlm
        | GateMode::Paper
        | GateMode::Distilled
        | GateMode::Replay => {
            let mode = format!("{:?}", config.gate.mode).to_lowercase();
            return refused(format!("an actor has no judge for gate.mode {mode}"));
        }
    }
    let mut config = config.clone();
    config.run.clock = RunClock::Lockstep;
    Ok(config)
}

impl Episodes {
    /// Of a training's configuration.
    ///
    /// # Errors
    /// As [`in_lockstep`].
    pub fn new(config: &Config) -> Result<Episodes, Failure> {
        let config = in_lockstep(config)?;
        Ok(Episodes {
            mover: Mover::new(&config),
            config,
        })
    }

    /// A policy for one episode.
    ///
    /// # Errors
    /// When the file is refused.
    pub fn policy(&self, version: u64, file: &[u8]) -> Result<Box<dyn Policy>, policy::Refusal> {
        let terms = controller::Terms {
            config: &self.config,
            version,
            clock: still,
        };
        controller::build(file, &terms)
    }

    /// Drives an episode for so many ticks at most. `watch` gets each step, with tick and time
    /// from the beginning of the episode, and may end it. Returns the number of ticks.
    ///
    /// # Errors
    /// When its seed has no map, or the configuration is out of range.
    pub fn drive(
        &self,
        key: EpisodeKey,
        ticks_max: u32,
        policy: Option<Box<dyn Policy>>,
        watch: impl FnMut(&Step) -> ControlFlow<()>,
    ) -> anyhow::Result<u32> {
        let first = Observation {
            header: Header {
                sequence: 1,
                episode: key.number(),
                ..Header::default()
            },
            ..Observation::default()
        };
        let rebuilt = self.mover.begin(self.mover.world()?, &first)?;
        let start = Start {
            observation: observe(&rebuilt, &first),
            rebuilt,
            last: None,
            planned: Vec::new(),
        };
        let drive = Drive {
            config: &self.config,
            mover: &self.mover,
            seconds: f64::from(ticks_max) * self.config.run.period_ns() as f64 * 1e-9,
            clock: still,
        };
        let driven = drive.run_watched(start, Wheel::Stack(policy), watch)?;
        Ok(driven.ticks as u32)
    }
}
