//! A recorded episode up to the tick at which it is forked, and on to its end.

use anyhow::{Context, bail};
use shm_config::config::Config;
use shm_config::difference::first_difference;
use shm_config::message::{Message, Observation};

use crate::replay::messages::{AnyMessage, Messages, taken};
use crate::replay::rebuild::{Mover, Rebuilt, Sent, observe};
use crate::replay::source::Source;

/// Steps before an episode that are kept: of the commands that its first ticks may apply,
/// and of the controller's state.
const KEPT: usize = 32;

/// Messages after the first observation of the next episode, among which is the one that
/// says how the episode ended.
const AFTER: usize = 256;

/// How much of a recording is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Until {
    /// To the end of the episode of the tick.
    Episode,
    /// To the end of the recording.
    End,
}

/// The messages from the beginning of an episode on.
pub struct Course {
    /// The configuration as it ran.
    pub config: Config,
    /// The messages.
    pub messages: Messages,
    /// The commands that were sent.
    pub sent: Sent,
    /// The observation at which it is forked: the first of that tick or, where the tick was
    /// skipped, of the next one.
    pub at: usize,
}

impl Course {
    /// Reads the episode of a tick.
    ///
    /// # Errors
    /// When the recording cannot be read, or has no such tick.
    pub fn read(source: &mut dyn Source, tick: u64, until: Until) -> anyhow::Result<Course> {
        let mut messages = Messages::default();
        let mut current = None;
        let mut at = None;
        let mut last_tick = None;
        let mut left = usize::MAX;
        while let Some(message) = source.next()? {
            if let AnyMessage::Observation(observation) = &message {
                let header = observation.header;
                let of = Some((header.producer, header.episode));
                match at {
                    None if of != current => messages = beginning(&messages),
                    Some(_) if of != current && until == Until::Episode => {
                        left = left.min(AFTER);
                        continue;
                    }
                    None | Some(_) => {}
                }
                current = of;
                if at.is_none() && header.tick >= tick {
                    at = Some(messages.observations.all.len());
                }
                last_tick = last_tick.max(Some(header.tick));
            }
            messages.push(message);
            left -= 1;
            if left == 0 {
                break;
            }
        }
        let Some(at) = at else {
            match last_tick {
                Some(last) => bail!("--tick {tick}: the recording ends at tick {last}"),
                None => bail!("the recording has no observation"),
            }
        };
        Ok(Course {
            config: source.config().clone(),
            sent: Sent::new(&messages.steps.all),
            messages,
            at,
        })
    }

    /// The observation at which it is forked.
    pub fn observation(&self) -> &Observation {
        &self.messages.observations.all[self.at]
    }

    /// The end of the episode of this observation: one after its last observation.
    pub fn end_of_episode(&self, first: usize) -> usize {
        let all = &self.messages.observations.all;
        let of =
            |observation: &Observation| (observation.header.producer, observation.header.episode);
        let same = all[first..]
            .iter()
            .take_while(|next| of(next) == of(&all[first]));
        first + same.count()
    }

    /// Moves the world from the beginning of the episode to an observation, and compares
    /// each on the way.
    ///
    /// # Errors
    /// The first tick at which the world cannot be moved, or differs.
    pub fn rebuild(
        &self,
        mover: &Mover,
        (first, at): (usize, usize),
        mut reached: impl FnMut(usize, &Rebuilt),
    ) -> anyhow::Result<Rebuilt> {
        let all = &self.messages.observations.all;
        let begun = mover.begin(mover.world()?, &all[first]);
        let mut rebuilt = begun.with_context(|| format!("tick {}", all[first].header.tick))?;
        let again = observe(&rebuilt, &all[first]);
        check(&all[first], &again)?;
        reached(first, &rebuilt);
        for (index, recorded) in all.iter().enumerate().take(at + 1).skip(first + 1) {
            let again = self.follow(mover, &mut rebuilt, recorded)?;
            check(recorded, &again)?;
            reached(index, &rebuilt);
        }
        Ok(rebuilt)
    }

    /// Moves the world to a recorded observation.
    fn follow(
        &self,
        mover: &Mover,
        rebuilt: &mut Rebuilt,
        recorded: &Observation,
    ) -> anyhow::Result<Box<Observation>> {
        let tick = recorded.header.tick;
        let told = self.messages.progress.at(taken(recorded.header()));
        let braked = told.map(|progress| progress.braked);
        let followed = mover.follow(rebuilt, (recorded, braked), &self.sent);
        followed
            .map_err(|astray| anyhow::anyhow!("tick {tick}: {astray}; the world cannot be rebuilt"))
    }

    /// The first observation of the episode of `at`.
    pub fn beginning(&self, at: usize) -> usize {
        let all = &self.messages.observations.all;
        let of =
            |observation: &Observation| (observation.header.producer, observation.header.episode);
        let back = all[..at]
            .iter()
            .rev()
            .take_while(|before| of(before) == of(&all[at]));
        at - back.count()
    }
}

/// What an episode needs of the messages before it.
fn beginning(messages: &Messages) -> Messages {
    let steps = &messages.steps.all;
    let mut kept = Messages::default();
    for step in &steps[steps.len().saturating_sub(KEPT)..] {
        kept.push(AnyMessage::Step(*step));
    }
    kept
}

/// The world is the recorded one, bit by bit.
fn check(recorded: &Observation, again: &Observation) -> anyhow::Result<()> {
    match first_difference(recorded, again) {
        None => Ok(()),
        Some(found) => bail!(
            "tick {}: the rebuilt world differs in observation.{}: recorded {}, rebuilt {}; was \
             it recorded with this build?",
            recorded.header.tick,
            found.field,
            found.left,
            found.right
        ),
    }
}
