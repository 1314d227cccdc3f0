//! One episode, driven tick by tick as the processes do in lockstep.

use shm_config::Instant;
use shm_config::message::{Command, Episode, Header, Observation, Plan};
use sim::score::Score;
use sim::{StepOutcome, World, WorldError};

use crate::seat::Seat;

/// One tick, for those who watch: what was seen, what was commanded, and what
/// came of it.
pub struct Tick<'a> {
    /// What the ego perceived.
    pub observation: &'a Observation,
    /// What was planned for it; none by drivers that do not plan.
    pub plan: Option<&'a Plan>,
    /// What it was told.
    pub command: &'a Command,
    /// What that led to.
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
    seat: &mut Seat,
    (seed, period_ns): (u64, u64),
    mut watch: impl FnMut(&Tick),
) -> Result<Episode, WorldError> {
    world.reset(seed)?;
    seat.begin(seed);
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
        let command = seat.command(&observation, world);
        tick += 1;
        let action = score.obey(Some(&command), Instant(tick * period_ns));
        let outcome = world.step(action);
        score.count(&outcome);
        watch(&Tick {
            observation: &observation,
            plan: seat.plan(),
            command: &command,
            outcome,
            world,
        });
    }
    let outcome = world.last_step().outcome;
    Ok(score.episode(world, outcome))
}
