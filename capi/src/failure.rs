//! What a call returns: a code, and a line of text for those below zero.

use runtime::SetUpError;
use shm_config::message::Refusal;
use shm_config::wire::WireError;
use shm_config::word_list;

word_list! {
    /// The codes at which a call was carried out.
    pub enum Answer {
        /// Done.
        Ok = 0 "ok",
        /// There is no new message.
        None = 1 "none",
        /// The run is over, or the process was asked to stop: leave and exit with 0.
        Ended = 2 "ended",
    }
}

word_list! {
    /// The kinds of failures; a call returns them as negative numbers.
    pub enum Kind {
        /// A message failed its check; the text names the field. Nothing was sent.
        Refused = 1 "refused",
        /// An argument is wrong: NULL, a length, a name, a row of another process.
        Invalid = 2 "invalid",
        /// Two sides have different layouts of a message; the text names both.
        Layout = 3 "other layout",
        /// Shared memory or the configuration refuses.
        Failed = 4 "failed",
        /// A defect of the library. The membership is gone; exit with an error.
        Panicked = 5 "panicked",
    }
}

/// A call that failed.
#[derive(Debug)]
pub struct Failure {
    /// What kind.
    pub kind: Kind,
    /// What, where, what to do: one line.
    pub text: String,
}

impl Failure {
    /// A wrong argument.
    pub fn invalid(text: impl Into<String>) -> Self {
        Self {
            kind: Kind::Invalid,
            text: text.into(),
        }
    }

    /// A message of this service that its check refuses.
    pub fn refused(service: &str, refusal: &Refusal) -> Self {
        Self {
            kind: Kind::Refused,
            text: format!("{service}: {refusal}"),
        }
    }

    /// A layout that differs from this library's.
    pub fn layout(theirs: u64, ours: u64) -> Self {
        Self {
            kind: Kind::Layout,
            text: format!(
                "this program was built with the header of message layout {theirs:016x}, this \
                 libvlaps has {ours:016x}; build both from one source"
            ),
        }
    }

    /// The number that the call returns.
    pub fn code(&self) -> i32 {
        -(self.kind.code() as i32)
    }
}

impl From<WireError> for Failure {
    fn from(error: WireError) -> Self {
        let kind = match error {
            WireError::Layout { .. } => Kind::Layout,
            _ => Kind::Failed,
        };
        Self {
            kind,
            text: error.to_string(),
        }
    }
}

impl From<SetUpError> for Failure {
    fn from(error: SetUpError) -> Self {
        match error {
            SetUpError::Wire(error) => error.into(),
            other => Self {
                kind: Kind::Failed,
                text: other.to_string(),
            },
        }
    }
}
