//! The live page: what a run does now, in a browser.
//!
//! ```text
//! shared memory -> reader -> painter, history, events, status -> hub -> connections
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`command`] | `./vlaps view` |
//! | [`reader`] | one more reader of a living run, 20 times a second |
//! | [`scene`], [`history`], [`events`], [`status`], [`tree`] | what the page draws |
//! | [`hub`] | what reader and connections share: the newest wins |
//! | [`tape`] | the same of a recording, on request |
//! | [`fleet`] | all runs of the user on one page |
//! | [`source`], [`server`], [`guard`] | the paths, and who may read them |
//! | [`listening`] | a port, its thread and its connections |
//! | [`page`] | the page's files |
//! | [`foxglove`] | the same run for Foxglove and Lichtblick |

pub mod command;
pub mod events;
pub mod fleet;
pub mod foxglove;
pub mod guard;
pub mod hello;
pub mod history;
pub mod hub;
pub mod listening;
pub mod page;
pub mod reader;
pub mod scene;
pub mod server;
pub mod source;
pub mod status;
pub mod tape;
pub mod tree;
