//! The integration tests of this crate, one program: each program is linked anew.

mod assembler;
mod checkpoint;
mod elsewhere;
mod features;
mod journal;
mod relearn;
mod replay;
mod steps;
mod takeover;
