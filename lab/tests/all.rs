//! The integration tests of this crate, one program: each program is linked anew.

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
