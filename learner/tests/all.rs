//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p learner --test all NAME::` runs those of one file.

mod assembler;
mod checkpoint;
mod elsewhere;
mod features;
mod journal;
mod relearn;
mod replay;
mod steps;
mod takeover;
