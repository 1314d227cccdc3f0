//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p lab --test all NAME::` runs those of one file.

mod actor_faults;
mod actor_network;
mod actors;
mod command_line;
mod flipped_bits;
mod parity;
mod pictures;
mod replay;
mod replay_learner;
mod shards;
mod small_training;
mod training;
