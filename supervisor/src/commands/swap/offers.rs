//! Offers of weights to a controller, and its answers.

use std::time::Duration;

use sha2::{Digest, Sha256};
use shm_config::message::{PolicyState, PolicyStatus, Weights};
use shm_config::services::{POLICY_STATUS, WEIGHTS};
use shm_config::wire::{Publisher, Subscriber, Wire};
use shm_config::{Instant, Message};

use crate::Clock;
use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::machine::signals::pause;
use crate::show::policy_view::UNKEPT;

/// Time between two reads of the status.
const LOOK: Duration = Duration::from_millis(2);
/// How long the first status of the controller may take, ns.
const GREET_NS: u64 = 2_000_000_000;
/// How long an answer may take, ns: long enough for a restart of the controller.
pub(super) const ANSWER_NS: u64 = 30_000_000_000;
/// How long the canary period may last without a message of the controller, ns.
const READY_NS: u64 = 600_000_000_000;
/// The result of an offer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// Adopted at this tick.
    Adopted {
        /// The tick.
        tick: u64,
    },
    /// It may drive from this tick on.
    Ready {
        /// The tick.
        tick: u64,
    },
    /// Refused or rolled back, and why.
    Refused(String),
    /// Another publisher offered this version, or a later one, first.
    Overtaken(u64),
}

/// The publisher of weights and the subscriber of their status.
pub struct Offers {
    weights: Publisher<Weights>,
    statuses: Subscriber<PolicyStatus>,
    newest: Option<PolicyStatus>,
}

impl Offers {
    /// Opens both ends.
    ///
    /// # Errors
    /// When the layout differs from the running side's, or shared memory refuses.
    pub fn open(wire: &Wire) -> Result<Self, Failure> {
        Ok(Self {
            statuses: wire.subscriber(POLICY_STATUS)?,
            weights: wire.publisher(WEIGHTS)?,
            newest: None,
        })
    }

    /// The version of the next offer: one more than the last that was offered. If
    /// another publisher offers this version first, this offer is refused as overtaken,
    /// and the next version is read again.
    pub fn next_version(&mut self, clock: Clock) -> u64 {
        let begun = clock();
        while self.look().is_none() && clock().since_ns(begun) < GREET_NS {
            pause(LOOK);
        }
        let newest = self.newest;
        newest.map_or(0, |status| status.offered_version.max(status.version)) + 1
    }

    /// Offers a file. Returns whether it went out.
    pub fn offer(&mut self, version: u64, bytes: &[u8]) -> bool {
        self.weights.update_connections();
        self.weights
            .offer(version, Sha256::digest(bytes).into(), bytes)
    }

    /// Waits for the controller's decision about an offer.
    ///
    /// # Errors
    /// When none comes.
    pub fn answer(
        &mut self,
        version: u64,
        bytes: &[u8],
        clock: Clock,
        limit_ns: u64,
    ) -> Result<Answer, Failure> {
        let hash = short_hash(bytes);
        let begun: Instant = clock();
        loop {
            // A controller that restarted in the meantime gets the offer again.
            self.weights.update_connections();
            let status = self.look();
            if let Some(answer) = status.and_then(|status| outcome_of(&status, version, hash)) {
                return Ok(answer);
            }
            if clock().since_ns(begun) > limit_ns {
                return Err(Failure::GivenUp(
                    "the controller does not answer; `./vlaps status` shows how it does".into(),
                ));
            }
            pause(LOOK);
        }
    }

    pub(super) fn await_ready(
        &mut self,
        version: u64,
        bytes: &[u8],
        clock: Clock,
    ) -> Result<(), Failure> {
        let hash = short_hash(bytes);
        let begun = clock();
        let adopter = self.newest.map(|status| status.header.producer);
        while clock().since_ns(begun) < READY_NS {
            let status = self.look();
            let speaker = status.map(|status| status.header.producer);
            if speaker != adopter
                && status.is_some_and(|status| outcome_of(&status, version, hash).is_none())
            {
                return Err(Failure::GivenUp(
                    "the controller was restarted before the canary period ended, and continues \
                     with the previous weights; swap again"
                        .into(),
                ));
            }
            match status.and_then(|status| outcome_of(&status, version, hash)) {
                Some(Answer::Ready { tick }) => {
                    say(format_args!(
                        "canary period passed: may drive from tick {tick} on"
                    ));
                    self.warn_of_unkept();
                    return Ok(());
                }
                Some(Answer::Refused(reason)) => return Err(Failure::GivenUp(reason)),
                Some(Answer::Overtaken(later)) => {
                    return Err(Failure::GivenUp(format!(
                        "version {later} was offered before the canary period ended"
                    )));
                }
                Some(Answer::Adopted { .. }) | None => pause(LOOK),
            }
        }
        Err(Failure::GivenUp("the canary period does not end".into()))
    }

    pub(super) fn warn_of_unkept(&self) {
        if self.newest.is_some_and(|status| status.unkept != 0) {
            say(format_args!("warning: the weights are {UNKEPT}"));
        }
    }

    /// The newest status; `None` before the controller's first.
    fn look(&mut self) -> Option<PolicyStatus> {
        self.statuses.update_connections();
        if let Some(status) = self.statuses.newest(Message::check) {
            self.newest = Some(status);
        }
        self.newest
    }
}

/// The answer to an offer in a status; `None` when the status does not know the offer
/// yet.
fn outcome_of(status: &PolicyStatus, version: u64, hash: u64) -> Option<Answer> {
    if (status.version, status.hash) == (version, hash) {
        let tick = status.header.tick;
        return Some(Answer::Ready { tick });
    }
    if status.offered_version > version {
        return Some(Answer::Overtaken(status.offered_version));
    }
    if status.offered_version < version {
        return None;
    }
    if status.offered_hash != hash {
        return Some(Answer::Overtaken(version));
    }
    match status.state() {
        PolicyState::Empty => None,
        PolicyState::Shadow => Some(Answer::Adopted {
            tick: status.adopted_tick,
        }),
        PolicyState::Ready => Some(Answer::Ready {
            tick: status.header.tick,
        }),
        PolicyState::Refused | PolicyState::RolledBack => {
            Some(Answer::Refused(status.refusal().into_owned()))
        }
    }
}

/// The beginning of the SHA-256, as statuses carry it.
fn short_hash(bytes: &[u8]) -> u64 {
    let hash = Sha256::digest(bytes);
    let first = hash.iter().take(8);
    first
        .fold(0, |hash, &byte| hash << 8 | u64::from(byte))
        .max(1)
}
