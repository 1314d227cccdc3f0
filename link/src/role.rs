//! What a peer is, and the rows that it may hear and send.

use shm_config::layout::{FNV_BASIS, fnv1a};
use shm_config::services::{
    ADVICE, EPISODE, FORESIGHT, FRAME, FRAME_REQUEST, HEALTH, LEARNING, Leaves, POLICY_STATUS,
    PROGRESS, Process, Row, SERVICES, STEP, TIMING, WEIGHTS,
};

/// The version of what the link itself sends, beside the layouts of the messages.
const PROTOCOL: u64 = 2;

shm_config::word_list! {
    /// What a peer is on its machine.
    pub enum Role {
        /// The gate process: reads steps and pictures, sends advice.
        Judge = 1 "judge",
        /// The learner process: reads steps, sends weights.
        Learner = 2 "learner",
        /// A page for a browser: sends nothing.
        View = 3 "view",
        /// Recordings: sends nothing.
        Recorder = 4 "recorder",
        /// Worlds of a training, whose learner listens itself: neither hears nor sends here.
        Actor = 5 "actor",
    }
}

/// How a row passes the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Passage {
    /// The newest message, again and again until it is acknowledged or replaced.
    Newest,
    /// Every message in order, from a queue of limited length.
    Every,
}

/// One row of what is sent: a service, or the configuration.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RowId(pub u8);

/// The run's configuration, which is not a service.
pub const CONFIG: RowId = RowId(0);
/// First code of the family `health/*`; the process's code is added.
const HEALTH_FIRST: u8 = 32;
/// First code of the family `timing/*`.
const TIMING_FIRST: u8 = 48;

/// The codes of the rows that may leave the machine.
const CODES: [(u8, &Row); 10] = [
    (1, &STEP.row),
    (2, &EPISODE.row),
    (3, &FRAME.row),
    (4, &FORESIGHT.row),
    (5, &POLICY_STATUS.row),
    (6, &PROGRESS.row),
    (7, &ADVICE.row),
    (8, &FRAME_REQUEST.row),
    // Before the progress that names their version.
    (9, &WEIGHTS.row),
    (10, &LEARNING.row),
];

impl RowId {
    /// The code of a service by its name on the wire; `None` for one that stays.
    pub fn of(service: &str) -> Option<Self> {
        let single = CODES.iter().find(|(_, row)| row.name == service);
        let family = |row: &Row, first: u8| {
            let place = row.instances.iter().position(|name| *name == service)?;
            Some(Self(first + place as u8))
        };
        match single {
            Some((code, row)) => (row.leaves != Leaves::No).then_some(Self(*code)),
            None => family(&HEALTH.row, HEALTH_FIRST).or_else(|| family(&TIMING.row, TIMING_FIRST)),
        }
    }

    /// The service's name on the wire; `None` for a code that is none.
    pub fn service(self) -> Option<&'static str> {
        let of_family = |row: &Row, first: u8| {
            let place = self.0.checked_sub(first)? as usize;
            row.instances.get(place).copied()
        };
        match self {
            CONFIG => Some("config"),
            _ => CODES
                .iter()
                .find(|(code, _)| *code == self.0)
                .map(|(_, row)| row.name)
                .or_else(|| of_family(&HEALTH.row, HEALTH_FIRST))
                .or_else(|| of_family(&TIMING.row, TIMING_FIRST)),
        }
    }

    /// How the row passes to a peer of this role.
    pub fn passage(self, role: Role) -> Passage {
        let every = [RowId::of(STEP.name), RowId::of(EPISODE.name)].contains(&Some(self));
        // A judge is asked about the newest step alone; an older one only costs time.
        match every && role != Role::Judge {
            true => Passage::Every,
            false => Passage::Newest,
        }
    }
}

impl Role {
    /// The services that a peer of this role may send. A command, a plan, an observation or
    /// a takeover is in no list.
    pub fn may_send(self, row: RowId) -> bool {
        let named = |services: &[&str]| row.service().is_some_and(|name| services.contains(&name));
        match self {
            // The request is for the picture that the question shows.
            Self::Judge => named(&[ADVICE.name, FRAME_REQUEST.name]),
            Self::Learner => named(&[LEARNING.name, WEIGHTS.name]),
            Self::View | Self::Recorder | Self::Actor => false,
        }
    }

    /// Whether the vehicle sends a row to peers of this role.
    pub fn hears(self, row: RowId) -> bool {
        let named = |services: &[&str]| row.service().is_some_and(|name| services.contains(&name));
        match self {
            _ if row == CONFIG => self != Self::Actor,
            Self::Judge => named(&[STEP.name, FRAME.name, FORESIGHT.name]),
            Self::Learner => named(&[STEP.name, POLICY_STATUS.name]),
            // Megabytes that a page or a file of another machine can do without.
            Self::View | Self::Recorder => !named(&[WEIGHTS.name]),
            Self::Actor => false,
        }
    }

    /// The process of the run in whose place the link stands for this role; `None` for a
    /// role that only reads.
    pub fn stands_for(self) -> Option<Process> {
        match self {
            Self::Judge => Some(Process::Gate),
            Self::Learner => Some(Process::Learner),
            Self::View | Self::Recorder | Self::Actor => None,
        }
    }

    /// The role of a word.
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|role| role.word() == word)
    }
}

/// A hash of all that both ends have to agree on: the link's own format, and the layout of
/// each message that may leave the machine.
pub fn layouts() -> u64 {
    let mut hash = fnv1a(FNV_BASIS, &PROTOCOL.to_le_bytes());
    for row in SERVICES.iter().filter(|row| row.leaves != Leaves::No) {
        hash = fnv1a(hash, row.name.as_bytes());
        hash = fnv1a(hash, &row.message.fingerprint.to_le_bytes());
    }
    hash
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table of services decides what leaves; a new row needs a code here.
    #[test]
    fn each_row_that_leaves_has_a_code_and_no_other_has() {
        for row in SERVICES {
            for service in row.instances {
                let code = RowId::of(service);
                assert_eq!(code.is_some(), row.leaves != Leaves::No, "{service}");
                if let Some(code) = code {
                    assert_eq!(code.service(), Some(*service));
                }
            }
        }
    }

    #[test]
    fn no_role_sends_what_moves_the_car() {
        for role in Role::ALL {
            let sends = (0..=u8::MAX).filter(|code| role.may_send(RowId(*code)));
            let sends: Vec<_> = sends.filter_map(|code| RowId(code).service()).collect();
            let expected: &[&str] = match role {
                Role::Judge => &["advice", "frame_request"],
                Role::Learner => &["weights", "learning"],
                Role::View | Role::Recorder | Role::Actor => &[],
            };
            assert_eq!(sends, expected, "{role}");
        }
        for service in [
            "command",
            "plan",
            "observation",
            "takeover",
            "fault",
            "roster",
        ] {
            assert_eq!(RowId::of(service), None, "{service}");
        }
    }
}
