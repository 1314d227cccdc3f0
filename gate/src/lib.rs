//! The gate process: when a judge is asked, which judge, and what its answer means.
//!
//! Steps come in, [`query`] says what is asked of a judge, [`judge`] holds the judges,
//! [`advice`] turns their answers into advice that expires. A vision-language model is
//! shown a [`presentation`] of the question and asked over HTTP by [`model`]. Everything
//! asked and answered goes into the [`record`]. Nothing here can delay a tick: that is
//! the crate `safety`.

pub mod advice;
pub mod judge;
pub mod model;
pub mod ports;
pub mod presentation;
pub mod query;
pub mod record;
mod run;

pub use run::run;
