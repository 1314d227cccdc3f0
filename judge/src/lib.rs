//! A vision-language model as judge.
//!
//! A [`gate::Question`] becomes pictures (the frame of its tick with both
//! rollouts drawn in), prompts, and HTTP requests; what comes back becomes an
//! answer or a counted fault, never a guess. How the two proposals are shown is
//! decided once, in a [`Showing`]: the picture is drawn and the prompt is worded
//! from the same value, so they cannot disagree. Everything asked is kept as a
//! [`record::Record`], to be audited and asked again.

mod clerk;
pub mod record;
mod recorded;
mod showing;

pub use clerk::{Clerk, Evidence, Filed};
pub use recorded::Recorded;
pub use showing::{Hue, Party, Reply, Showing, combine};
