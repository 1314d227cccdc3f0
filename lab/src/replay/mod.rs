//! `./vlaps replay`: a recorded run, recomputed with the shipped code and compared bit by
//! bit.
//!
//! | module | holds |
//! |---|---|
//! | [`messages`], [`source`] | the messages of a recording, a stretch at a time |
//! | [`run`], [`findings`] | a replay from the first message to the last, and what differs |
//! | [`worlds`], [`plans`], [`ticks`], [`advice`], [`learning`] | one process each: world, planner, controller, gate, learner |
//! | [`what_if`] | what another planner, limit or judge would have said |
//! | [`recorded`] | a recording on disk |
//! | [`command`] | the command's options and output |
//! | [`rebuild`] | the built-in world, moved again as recorded |
//! | [`rehearsal`] | runs made in this process, for tests and measurements |

pub mod advice;
pub mod command;
pub mod findings;
pub mod learning;
pub mod messages;
pub mod plans;
pub mod rebuild;
pub mod recorded;
pub mod rehearsal;
pub mod run;
pub mod source;
pub mod ticks;
pub mod what_if;
pub mod worlds;
