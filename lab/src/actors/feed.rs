//! Steps of separate episodes, as the steps of one run that the learning session reads.
//!
//! An actor counts ticks and time from the beginning of its episode. The session joins steps
//! that follow each other, and sees an episode's end in the next one's beginning. So the steps
//! get the headers that one world and one controller would have given them in this order.

use learner::session::Session;
use shm_config::message::{Header, Step};

use super::message::EpisodeKey;

/// The controller and the world of the steps: any numbers that never change.
const CONTROLLER: u32 = 1;
const WORLD: u32 = 2;

/// Gives a step the place that it has after `driven` steps, of which those before `begun`
/// belong to earlier episodes.
pub fn place(step: &mut Step, (begun, driven): (u64, u64), key: EpisodeKey, period_ns: u64) {
    // A session takes no step at time 0 for a new one.
    let begun_ns = begun.saturating_add(1).saturating_mul(period_ns);
    let header = Header {
        tick: driven,
        taken_ns: begun_ns.saturating_add((driven - begun).saturating_mul(period_ns)),
        sequence: driven + 1,
        episode: key.number(),
        producer: CONTROLLER,
    };
    step.header = header;
    step.observation.header = Header {
        producer: WORLD,
        ..header
    };
    let advice = &mut step.advice;
    advice.label_from_ns = advice.label_from_ns.saturating_add(begun_ns);
    advice.label_until_ns = advice.label_until_ns.saturating_add(begun_ns);
    if advice.answers > 0 {
        // Greater than in all episodes before, which had an answer a tick at most.
        advice.answers = advice.answers.saturating_add(begun.saturating_mul(2));
    }
}

/// Feeds an episode to the session.
pub fn feed(session: &mut Session, key: EpisodeKey, steps: Vec<Box<Step>>, period_ns: u64) {
    let begun = session.driven();
    for mut step in steps {
        place(&mut step, (begun, session.driven()), key, period_ns);
        session.push(&step);
    }
}
