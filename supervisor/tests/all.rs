//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p supervisor --test all NAME::` runs those of one file.

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
