//! The wire: messages, service table, age limits, time, configuration.
//!
//! The only crate that names iceoryx2. It holds everything on which two processes must
//! agree.
//!
//! The feature `wire` (default) adds what needs iceoryx2 or Linux: ports, runs, files,
//! secrets and the machine's clock. The feature `std`, which it includes, adds what
//! allocates: the configuration file, the service table as a page, texts. Messages,
//! services and the tick's settings need neither; without `std`, the feature `libm`
//! gives the mathematics.
//!
//! | module | holds |
//! |---|---|
//! | [`mod@message`] | the messages, and the check that each passes once |
//! | [`services`] | the service table: name, message, producers, consumers, rate, age limit |
//! | [`settings`], `config` | what the tick computes with; the file of all settings |
//! | `wire` | ports on shared memory |
//! | `run`, `file`, `secret` | the run's folder, files with locks, the key |
//! | [`time`], [`layout`], [`histogram`] | instants, pinned layouts, durations in buckets |
//!
//! ```
//! use shm_config::message::{Message, Observation, Refusal};
//! use shm_config::{Instant, services};
//!
//! let (now, limit_ns) = (Instant(1_000), 500);
//! let mut observation = Observation::default();
//! let stale = Refusal::Stale { age_ns: 1_000, limit_ns };
//! assert_eq!(observation.admit(now, limit_ns), Err(stale));
//! observation.header.taken_ns = 800;
//! assert_eq!(observation.admit(now, limit_ns), Ok(()));
//! observation.ego.speed_mps = f64::NAN;
//! assert!(observation.admit(now, limit_ns).is_err());
//! assert_eq!(services::OBSERVATION.name, "observation");
//! ```

#![cfg_attr(not(feature = "std"), no_std)]

#[cfg(feature = "std")]
pub mod config;
#[cfg(feature = "std")]
mod counted;
#[cfg(feature = "std")]
pub mod difference;
#[cfg(feature = "std")]
pub mod draw;
#[cfg(feature = "wire")]
pub mod file;
#[cfg(feature = "std")]
mod grid;
pub mod histogram;
#[cfg(feature = "std")]
pub mod judged;
pub mod layout;
pub mod message;
#[cfg(feature = "std")]
pub mod palette;
#[cfg(feature = "wire")]
pub mod python;
#[cfg(feature = "wire")]
pub mod run;
#[cfg(feature = "wire")]
pub mod secret;
#[cfg(feature = "std")]
pub mod seen;
pub mod services;
pub mod settings;
#[cfg(feature = "std")]
mod shortened;
#[cfg(feature = "std")]
pub mod text;
pub mod time;
pub mod turns;
#[cfg(feature = "wire")]
#[allow(clippy::disallowed_types)] // the one place that may name iceoryx2
pub mod wire;

#[cfg(feature = "std")]
pub use counted::counted;
#[cfg(feature = "std")]
pub use grid::RunGrid;
pub use message::Message;
#[cfg(feature = "std")]
pub use shortened::shortened;
pub use time::Instant;
pub use turns::PlanTurns;
