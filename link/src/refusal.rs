//! Why something from the network is refused, and how often.

use serde::{Serialize, Serializer};

shm_config::word_list! {
    /// Why a message from the network is refused. Each is counted, none changes anything.
    pub enum Reason {
        /// Not of this protocol, cut short, or longer than anything that is sent.
        Malformed = 0 "malformed",
        /// For another run.
        OtherRun = 1 "other_run",
        /// Its key is not one that this run has made.
        WrongKey = 2 "wrong_key",
        /// The invitation is of another role than this port serves.
        WrongRole = 3 "wrong_role",
        /// The invitation has ended.
        Expired = 4 "expired",
        /// The invitation was revoked.
        Revoked = 5 "revoked",
        /// The other side has other message layouts.
        OtherLayout = 6 "other_layout",
        /// A peer of this role is here already.
        Occupied = 7 "occupied",
        /// Of a session that does not exist, or exists no more.
        NoSession = 8 "no_session",
        /// Changed on the way, or made without the session's key.
        Forged = 9 "forged",
        /// Received before.
        Replayed = 10 "replayed",
        /// A row that the peer's role may not send.
        NotAllowed = 11 "not_allowed",
        /// A message whose content is wrong.
        Content = 12 "content",
        /// Advice about a tick that this run has not driven.
        Undated = 13 "undated",
        /// A policy file that the learner's key has not signed.
        Unsigned = 14 "unsigned",
        /// More in a moment than is read.
        Flooded = 15 "flooded",
    }
}

/// How many reasons there are.
const REASONS: usize = Reason::ALL.len();

/// Refusals by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Refused([u64; REASONS]);

impl Refused {
    /// Counts one.
    pub fn count(&mut self, reason: Reason) {
        self.add(reason, 1);
    }

    /// Counts several.
    pub fn add(&mut self, reason: Reason, count: u64) {
        let place = &mut self.0[reason.code() as usize];
        *place = place.saturating_add(count);
    }

    /// How many of a reason.
    pub fn of(&self, reason: Reason) -> u64 {
        self.0[reason.code() as usize]
    }

    /// How many in all.
    pub fn all(&self) -> u64 {
        self.0.iter().sum()
    }
}

impl Serialize for Refused {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(
            Reason::ALL
                .iter()
                .map(|reason| (reason.word(), self.of(*reason))),
        )
    }
}
