//! The integration tests of this crate, one program: each program is linked anew.

mod command_line;
mod common;
mod folders;
mod log;
mod person;
mod place;
mod refusals;
mod set;
mod special;
mod table;
mod tally;
mod write;
