//! The built-in world as the plant of a world process.

use runtime::{Member, SetUpError};
use shm_config::config::{Config, DECISION_HZ};
use shm_config::message::{Command, Episode, Observation, Outcome, Progress};

use robot::Reading;
use robot::clock::Begin;
use robot::plant::{Moment, Plant};

use crate::render_thread::{LogWriter, Move, RenderThread, Seen};
use crate::score::Score;
use crate::substeps::Substeps;
use crate::{World, WorldConfig};

/// Runs the world until its episodes or its time are over, or it is stopped.
///
/// # Errors
/// When shared memory or the configuration refuses, or a seed has no map.
pub fn run(member: Member, begin: Begin) -> Result<(), SetUpError> {
    let built_in = BuiltIn::new(&member.config)?;
    robot::process::run(member, built_in, begin)
}

/// The world, with the thread that draws it.
struct BuiltIn {
    world: World,
    writer: LogWriter,
    _render_thread: RenderThread,
    substeps: Substeps,
    score: Score,
}

impl BuiltIn {
    /// Allocates everything; no map is built yet.
    fn new(config: &Config) -> Result<Self, SetUpError> {
        let world = World::new(WorldConfig::from(config))
            .map_err(|error| SetUpError::Own(error.to_string()))?;
        let (render_thread, writer) = RenderThread::start(config)?;
        Ok(Self {
            world,
            writer,
            _render_thread: render_thread,
            substeps: Substeps::new((config.world_rate_hz() / DECISION_HZ).round() as u64),
            score: Score::new(0),
        })
    }
}

impl Plant for BuiltIn {
    fn begin(&mut self, episode: u32, seed: u64) -> Result<(), String> {
        self.world.reset(seed).map_err(|error| error.to_string())?;
        self.writer.begin(episode, seed);
        self.score = Score::new(seed);
        Ok(())
    }

    /// Applies the command in the sub-steps that are due.
    fn advance(&mut self, moment: Moment, command: Option<&Command>) -> Option<Outcome> {
        let substeps = self.substeps.take(moment.index);
        if substeps == 0 {
            return None;
        }
        let action = self.score.obey(command, moment.now);
        self.writer.moved(Move { action, substeps });
        for _ in 0..substeps {
            let Some(step) = self.world.substep(action) else {
                continue;
            };
            self.score.count(&step);
            if step.has_ended() {
                return Some(step.outcome);
            }
        }
        None
    }

    fn observe(&mut self, moment: Moment, observation: &mut Observation) -> Reading {
        let passed = self.substeps.share(moment.index);
        self.world.observe_between(passed, observation);
        self.writer.saw(Seen {
            tick: moment.tick,
            taken_ns: moment.now.0,
            passed,
        });
        Reading::Fresh
    }

    fn progress(&self, outcome: Outcome) -> Progress {
        self.score.progress(&self.world, outcome)
    }

    fn episode(&self, outcome: Outcome) -> Episode {
        self.score.episode(&self.world, outcome)
    }
}
