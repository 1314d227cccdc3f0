//! One episode, driven tick by tick as the processes do in lockstep.

use shm_config::Instant;
use shm_config::message::{Command, Episode, Header, Observation, Plan};
use sim::score::Score;
use sim::{StepOutcome, World, WorldError};

use crate::driver::EpisodeDriver;

/// One tick of an episode: observation, plan, command and outcome.
pub struct Tick<'a> {
    /// The observation that the tick answers.
    pub observation: &'a Observation,
    /// Its plan; none of drivers that do not plan.
    pub plan: Option<&'a Plan>,
    /// The command that the world obeyed.
    pub command: &'a Command,
    /// What the command led to.
    pub outcome: StepOutcome,
    /// The world after the tick.
    pub world: &'a World,
}

/// Drives the episode of a seed to its end.
///
/// The headers are those of a run of one episode in lockstep, so that planner
/// and controller do, bit for bit, what their processes do.
///
/// # Errors
/// [`WorldError`] if the seed has no map.
pub fn drive(
    world: &mut World,
    driver: &mut EpisodeDriver,
    (seed, period_ns): (u64, u64),
    mut watch: impl FnMut(&Tick),
) -> Result<Episode, WorldError> {
    world.reset(seed)?;
    driver.begin(seed);
    let mut score = Score::new(seed);
    let mut observation = Box::<Observation>::default();
    let mut tick = 0;
    while !world.last_step().has_ended() {
        world.observe(&mut observation);
        observation.header = Header {
            tick,
            taken_ns: tick * period_ns,
            ..Header::default()
        };
        let command = driver.command(&observation, world);
        tick += 1;
        let action = score.obey(Some(&command), Instant(tick * period_ns));
        let outcome = world.step(action);
        score.count(&outcome);
        watch(&Tick {
            observation: &observation,
            plan: driver.plan(),
            command: &command,
            outcome,
            world,
        });
    }
    let outcome = world.last_step().outcome;
    Ok(score.episode(world, outcome))
}
