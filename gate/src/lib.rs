//! The gate process: when a judge is asked, which judge, and what its answer means.
//!
//! Steps come in. [`query`] defines what a judge is asked, [`judge`] holds the judges,
//! and [`advice`] turns their answers into advice that expires. A vision-language model
//! is shown a [`presentation`] of the question, and [`model`] asks it over HTTP. The
//! [`record`] keeps all questions and answers. Nothing here can delay a tick; the check
//! within the tick is the crate `safety`.

pub mod advice;
pub mod judge;
pub mod model;
pub mod ports;
pub mod presentation;
pub mod query;
pub mod record;
mod run;

pub use run::run;
