//! Recordings: every message of a run, as MCAP files.
//!
//! A recording is a folder of files `*.mcap` (<https://mcap.dev>). A channel is a service of
//! the service table, a message is the bytes of its struct behind four bytes that make it ROS
//! 2 CDR, and schemas are generated from the message layouts; other programs that read MCAP
//! open the files unchanged.
//!
//! Time: the publish time of a message is its `header.taken_ns`, on the run's clock. The log
//! time is epoch time, never decreases, and minus [`Origin::epoch_offset_ns`] is the run's
//! clock when the message was taken, or when it was recorded if an earlier one was taken
//! later.
//!
//! | module | holds |
//! |---|---|
//! | [`Recording`] | a folder or file that is read: entries in order of time, typed messages, attachments |
//! | [`Writer`] | one file that is written |
//! | [`schema`] | message layouts as ROS 2 definitions |
//! | `taps` | the reading ends of all recorded services of a running set |
//! | `standard` | topics of standard ROS 2 types, for viewers; readers leave them out |
//! | [`Origin`], [`Channel`] | where a recording is from; what it has |
//!
//! ```
//! use recorder::{Origin, Recording, Writer};
//! use shm_config::message::Step;
//! use shm_config::services::STEP;
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("example.mcap");
//! let mut writer = Writer::create(&path, &Origin::default())?;
//! let mut step = Step::default();
//! step.header.tick = 7;
//! writer.write(&STEP, 1_000, &step)?;
//! writer.finish()?;
//!
//! let recording = Recording::open(&path)?;
//! let steps = recording.messages(&STEP)?;
//! let ticks: Result<Vec<_>, _> = steps.map(|step| step.map(|step| step.header.tick)).collect();
//! assert_eq!(ticks?, [7]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod channel;
mod error;
mod origin;
#[cfg(feature = "process")]
pub mod process;
mod read;
pub mod schema;
#[cfg(feature = "standard")]
pub mod standard;
#[cfg(feature = "taps")]
pub mod taps;
mod write;

pub use channel::Channel;
pub use error::RecordingError;
pub use origin::Origin;
pub use read::{Attachment, Count, Entries, Entry, Messages, Recording};
pub use write::{ChannelId, Stamp, Writer};

/// The format of the recordings that this library writes, and the newest that it reads.
pub const FORMAT: u32 = 1;
/// The name of the attachment that is the configuration as it ran.
pub const CONFIGURATION: &str = "config.toml";
/// The folder of the attachments that are policy files; the name of each is its SHA-256 in
/// hexadecimal.
pub const POLICIES: &str = "policy/";
