//! A second world that follows the first one to any instant of the action log, and what
//! would follow there if an action were held.

use shm_config::message::{Header, Outcome, Outlook};
use vehicle::Action;

use super::action_log::{EpisodeLog, Move, Seen};
use crate::dynamics::SUBSTEP_S;
use crate::{World, WorldConfig, WorldError};

/// How long an action is held to see what follows, s: as long as a judge's record looks
/// ahead.
pub const HORIZON_S: f64 = 3.0;

/// A world that repeats the episodes of another.
pub struct Replica {
    world: World,
    /// The present episode, and the number of its moves made so far.
    made: Option<(u32, usize)>,
}

impl Replica {
    /// A world of the same configuration, in no episode of the run yet.
    ///
    /// # Errors
    /// [`WorldError`] if the configuration is out of range.
    pub fn new(config: WorldConfig) -> Result<Replica, WorldError> {
        Ok(Replica {
            world: World::new(config)?,
            made: None,
        })
    }

    /// Drives to an observed instant of an episode's log: from the present instant or,
    /// when that is later or in another episode, from the beginning of the episode.
    /// `begun` is called when the map has changed. `None` when the instant is not in
    /// the log.
    ///
    /// # Errors
    /// [`WorldError`] if the seed has no map.
    pub fn reach(
        &mut self,
        episode_log: &EpisodeLog,
        asked: &Header,
        begun: impl FnOnce(&World),
    ) -> Result<Option<(&World, Seen)>, WorldError> {
        let Some((seen, moves)) = episode_log.at(asked) else {
            return Ok(None);
        };
        let known = self
            .made
            .filter(|(episode, _)| *episode == episode_log.episode);
        let done = known
            .map(|(_, done)| done)
            .filter(|done| *done <= moves.len());
        let done = match done {
            Some(done) => done,
            None => {
                // Until its first move it is in no episode.
                self.made = None;
                self.world.reset(episode_log.seed)?;
                if known.is_none() {
                    begun(&self.world);
                }
                0
            }
        };
        for Move { action, substeps } in &moves[done..] {
            for _ in 0..*substeps {
                self.world.substep(*action);
            }
        }
        self.made = Some((episode_log.episode, moves.len()));
        Ok(Some((&self.world, seen)))
    }
}

/// What follows when an action is held from here to the horizon or the end of the
/// episode. The world itself is not changed.
pub fn outlook(world: &World, action: Action) -> Outlook {
    let mut world = world.clone();
    let began = world.completion();
    let mut outlook = Outlook {
        contact_s: HORIZON_S,
        out_s: HORIZON_S,
        completion: 0.0,
    };
    let last = (HORIZON_S / SUBSTEP_S).round() as u64;
    for substep in 1..=last {
        let Some(step) = world.substep(action) else {
            continue;
        };
        let passed_s = substep as f64 * SUBSTEP_S;
        if step.touch.vehicle || step.touch.object {
            outlook.contact_s = outlook.contact_s.min(passed_s);
        }
        if step.outcome == Outcome::OutOfRoad {
            outlook.out_s = passed_s;
        }
        if step.has_ended() {
            break;
        }
    }
    outlook.completion = (world.completion() - began).clamp(-1.0, 1.0);
    outlook
}
