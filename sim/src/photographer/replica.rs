//! A second world that is driven as the first one was, up to any instant on the
//! film; and what would come of an action there.

use shm_config::message::{Header, Outcome, Outlook};
use vehicle::Action;

use super::film::{Move, Reel, Seen};
use crate::dynamics::SUBSTEP_S;
use crate::{World, WorldConfig, WorldError};

/// How long an action is held to see what comes of it, s: what the record of a
/// judge looks at.
pub const HORIZON_S: f64 = 3.0;

/// A world that repeats.
pub struct Replica {
    world: World,
    /// The episode it is in, and how many of its moves are made.
    made: Option<(u32, usize)>,
}

impl Replica {
    /// A world of the same configuration; in no episode of the run yet.
    ///
    /// # Errors
    /// [`WorldError`] if the configuration is out of range.
    pub fn new(config: WorldConfig) -> Result<Replica, WorldError> {
        Ok(Replica {
            world: World::new(config)?,
            made: None,
        })
    }

    /// Drives to an observed instant on a reel, from where it is or, when that is later or
    /// in another episode, from the episode's beginning. `begun` is called when the
    /// map has changed. `None` when the instant is not on the reel.
    ///
    /// # Errors
    /// [`WorldError`] if the seed has no map.
    pub fn reach(
        &mut self,
        reel: &Reel,
        asked: &Header,
        begun: impl FnOnce(&World),
    ) -> Result<Option<(&World, Seen)>, WorldError> {
        let Some((seen, moves)) = reel.at(asked) else {
            return Ok(None);
        };
        let known = self.made.filter(|(episode, _)| *episode == reel.episode);
        let done = known
            .map(|(_, done)| done)
            .filter(|done| *done <= moves.len());
        let done = match done {
            Some(done) => done,
            None => {
                // Until it has begun anew it is in no episode.
                self.made = None;
                self.world.reset(reel.seed)?;
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
        self.made = Some((reel.episode, moves.len()));
        Ok(Some((&self.world, seen)))
    }
}

/// What comes of holding an action from here on, until the horizon or the
/// episode's end. The world itself stays as it is.
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
