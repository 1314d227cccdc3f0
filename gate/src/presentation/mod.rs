//! How two proposals are shown to a model: picture and prompt.
//!
//! How they are shown is decided once, in a [`Showing`]: the picture is drawn and the
//! prompt is worded from the same value, so they cannot disagree.

pub mod picture;
mod prompt;
mod showing;

pub use prompt::{LETTERS, PAPER_FORM, Prompt, SIMILAR, Schema, fixed_showing, view_words};
pub use showing::{Hue, Party, Reply, Showing, combine};
