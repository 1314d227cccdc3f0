//! Frames on the connection of a learner and an actor: a head of fixed size, then a body.
//!
//! The head has a magic number, the version of this format, a hash of the message layouts, the
//! kind, the length of the body and its checksum. A head that is wrong in any of them closes
//! the connection; nothing is read past it.

use std::io::{self, Read, Write};

use shm_config::layout::{FNV_BASIS, Layout, fnv1a};
use shm_config::message::{FEATURES_VERSION, Step, WEIGHTS_BYTES_MAX};
use shm_config::text::printable;

/// Begins each frame.
pub const MAGIC: [u8; 4] = *b"VLAC";
/// Version of the frames and of what an episode is.
pub const VERSION: u16 = 1;
/// Bytes of a head.
pub const HEAD_BYTES: usize = 24;
/// Most steps in a frame: with all beams a frame has 730 kB, which bounds what a connection
/// makes the learner hold before it is checked.
pub const STEPS_MAX: usize = 64;
/// Longest text of an error or of a build, bytes.
const TEXT_BYTES_MAX: usize = 4 << 10;
/// Longest text of an actor that is shown, bytes: a few lines.
const SHOWN_MAX: usize = 400;
/// Longest configuration, bytes; as of a configuration file.
const CONFIGURATION_BYTES_MAX: usize = 1 << 20;

/// What a frame holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Actor: its build, and the identity of its invitation.
    Hello = 1,
    /// Learner: the configuration.
    Welcome = 2,
    /// Learner: a policy file.
    Policy = 3,
    /// Learner: an episode to drive.
    Drive = 4,
    /// Learner: nothing is left to drive.
    Finish = 5,
    /// Actor: steps of an episode.
    Steps = 6,
    /// Actor: an episode has ended.
    Ended = 7,
    /// Actor: an episode cannot be driven.
    Failed = 8,
    /// Learner: this actor may not join, and why.
    Refused = 9,
}

impl Kind {
    const ALL: [Kind; 9] = [
        Kind::Hello,
        Kind::Welcome,
        Kind::Policy,
        Kind::Drive,
        Kind::Finish,
        Kind::Steps,
        Kind::Ended,
        Kind::Failed,
        Kind::Refused,
    ];

    fn from_code(code: u8) -> Option<Kind> {
        Kind::ALL.into_iter().find(|kind| *kind as u8 == code)
    }

    /// Longest body, bytes.
    pub const fn bytes_max(self) -> usize {
        match self {
            Kind::Hello | Kind::Failed | Kind::Refused => TEXT_BYTES_MAX,
            Kind::Welcome => CONFIGURATION_BYTES_MAX,
            Kind::Policy => 8 + WEIGHTS_BYTES_MAX,
            Kind::Drive | Kind::Ended => 32,
            Kind::Finish => 0,
            Kind::Steps => 24 + STEPS_MAX * (4 + size_of::<Step>()),
        }
    }
}

/// Why a frame is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rejection {
    /// It does not begin as a frame does.
    Magic,
    /// Another version of the format.
    Version,
    /// Another layout of the messages.
    Layout,
    /// A kind that does not exist, or that the other side does not send here.
    Kind,
    /// A body that is longer than its kind allows.
    Length,
    /// The checksum is of other bytes.
    Checksum,
    /// A number that is not finite or out of range, a count over its capacity, wrong lengths.
    Content,
    /// Steps that do not follow each other.
    Sequence,
    /// An episode, or more steps of it, than this actor was asked for.
    Unasked,
    /// Another build, whose planner might drive otherwise.
    Build,
    /// TLS refused it: no certificate of the run's authority, or one that has ended.
    Certificate,
    /// The certificate of another role.
    Role,
    /// An identity that is not in its certificate.
    Identity,
    /// Its invitation is revoked.
    Revoked,
}

impl Rejection {
    /// As in tables.
    pub fn word(self) -> &'static str {
        match self {
            Rejection::Magic => "no frame",
            Rejection::Version => "other version",
            Rejection::Layout => "other layout",
            Rejection::Kind => "unexpected kind",
            Rejection::Length => "too long",
            Rejection::Checksum => "wrong checksum",
            Rejection::Content => "invalid content",
            Rejection::Sequence => "steps out of order",
            Rejection::Unasked => "not asked for",
            Rejection::Build => "other build",
            Rejection::Certificate => "no certificate",
            Rejection::Role => "other role",
            Rejection::Identity => "other identity",
            Rejection::Revoked => "revoked",
        }
    }
}

/// Why a connection ends.
#[derive(Debug)]
pub enum Broken {
    /// The other side is gone, silent, or cut a frame short.
    Gone(io::Error),
    /// It sent a frame that is refused.
    Rejected(Rejection),
    /// It says that it cannot drive.
    Failed(String),
    /// The learner says why this actor may not join.
    TurnedAway(String),
}

impl std::fmt::Display for Broken {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Broken::Gone(error) => match error.kind() {
                io::ErrorKind::UnexpectedEof => write!(f, "the connection ended"),
                io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => write!(f, "silent"),
                _ => write!(f, "{error}"),
            },
            Broken::Rejected(why) => write!(f, "refused: {}", why.word()),
            Broken::TurnedAway(why) => write!(f, "the training refuses this actor: {why}"),
            Broken::Failed(text) => {
                // Text of another machine.
                let shown = &text[..text.floor_char_boundary(SHOWN_MAX)];
                write!(f, "cannot drive: {}", printable(shown))
            }
        }
    }
}

impl From<io::Error> for Broken {
    fn from(error: io::Error) -> Broken {
        Broken::Gone(error)
    }
}

impl From<Rejection> for Broken {
    fn from(why: Rejection) -> Broken {
        Broken::Rejected(why)
    }
}

/// A hash of the layouts that both sides have to share.
pub fn layouts() -> u64 {
    let mut hash = fnv1a(FNV_BASIS, &VERSION.to_le_bytes());
    hash = fnv1a(hash, &Step::FINGERPRINT.to_le_bytes());
    fnv1a(hash, &FEATURES_VERSION.to_le_bytes())
}

/// A frame that is being written; the buffer is used again.
#[derive(Default)]
pub struct Outgoing {
    bytes: Vec<u8>,
}

impl Outgoing {
    /// Begins a frame.
    pub fn begin(&mut self) -> &mut Vec<u8> {
        self.bytes.clear();
        self.bytes.resize(HEAD_BYTES, 0);
        &mut self.bytes
    }

    /// Goes on with a frame that was begun.
    pub fn more(&mut self) -> &mut Vec<u8> {
        &mut self.bytes
    }

    /// The whole frame of the body that was appended.
    pub fn close(&mut self, kind: Kind) -> &[u8] {
        let (head, body) = self.bytes.split_at_mut(HEAD_BYTES);
        // A body of this program keeps its limit, which is below 4 GB.
        let length = u32::try_from(body.len()).unwrap_or(u32::MAX);
        head[..4].copy_from_slice(&MAGIC);
        head[4..6].copy_from_slice(&VERSION.to_le_bytes());
        head[6] = kind as u8;
        head[7] = 0;
        head[8..16].copy_from_slice(&layouts().to_le_bytes());
        head[16..20].copy_from_slice(&length.to_le_bytes());
        head[20..24].copy_from_slice(&crc32c::crc32c(body).to_le_bytes());
        &self.bytes
    }

    /// Sends the frame of the body that was appended.
    ///
    /// # Errors
    /// When the other side is gone.
    pub fn send(&mut self, kind: Kind, line: &mut (impl Write + ?Sized)) -> Result<(), Broken> {
        let frame = self.close(kind);
        line.write_all(frame)?;
        line.flush()?;
        Ok(())
    }
}

/// Reads a frame of one of these kinds; `body` becomes its body.
///
/// # Errors
/// When the other side is gone, or the frame is refused.
pub fn receive(
    line: &mut (impl Read + ?Sized),
    wanted: &[Kind],
    body: &mut Vec<u8>,
) -> Result<Kind, Broken> {
    let mut head = [0; HEAD_BYTES];
    line.read_exact(&mut head)?;
    let (kind, length, sum) = parse(&head)?;
    if !wanted.contains(&kind) {
        return Err(Rejection::Kind.into());
    }
    body.clear();
    body.resize(length, 0);
    line.read_exact(body)?;
    match crc32c::crc32c(body) == sum {
        true => Ok(kind),
        false => Err(Rejection::Checksum.into()),
    }
}

/// Kind, length of the body, and checksum.
fn parse(head: &[u8; HEAD_BYTES]) -> Result<(Kind, usize, u32), Rejection> {
    let word = |at: usize| [head[at], head[at + 1], head[at + 2], head[at + 3]];
    if word(0) != MAGIC {
        return Err(Rejection::Magic);
    }
    if [head[4], head[5]] != VERSION.to_le_bytes() {
        return Err(Rejection::Version);
    }
    if head[8..16] != layouts().to_le_bytes() {
        return Err(Rejection::Layout);
    }
    let kind = Kind::from_code(head[6]).filter(|_| head[7] == 0);
    let kind = kind.ok_or(Rejection::Kind)?;
    let length = u32::from_le_bytes(word(16)) as usize;
    if length > kind.bytes_max() {
        return Err(Rejection::Length);
    }
    Ok((kind, length, u32::from_le_bytes(word(20))))
}
