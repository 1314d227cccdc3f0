//! The checks of commands.

use std::cmp::Ordering;

use shm_config::Instant;
use shm_config::message::{Command, Message, Refusal};

/// In real time: the content, the age, and that the command belongs to this episode.
pub fn admit(command: &Command, now: Instant, limit_ns: u64, episode: u32) -> Result<(), Refusal> {
    command.admit(now, limit_ns)?;
    check_episode(command, episode)
}

/// In lockstep, where time advances with the ticks: only the answer to the last
/// published tick is accepted.
pub fn admit_answer(
    command: &Command,
    asked: u64,
    period_ns: u64,
    episode: u32,
) -> Result<(), Refusal> {
    command.check()?;
    check_episode(command, episode)?;
    let tick = command.header.tick;
    let ticks_ns = |ticks: u64| ticks.saturating_mul(period_ns);
    match tick.cmp(&asked) {
        Ordering::Equal => Ok(()),
        Ordering::Less => Err(Refusal::Stale {
            age_ns: ticks_ns(asked - tick),
            limit_ns: 0,
        }),
        Ordering::Greater => Err(Refusal::Future {
            ahead_ns: ticks_ns(tick - asked),
        }),
    }
}

fn check_episode(command: &Command, episode: u32) -> Result<(), Refusal> {
    match command.header.episode == episode {
        true => Ok(()),
        false => Err(Refusal::Episode {
            episode: command.header.episode,
            expected: episode,
        }),
    }
}
