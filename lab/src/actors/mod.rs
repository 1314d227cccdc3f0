//! Many worlds, one learner: actors drive the episodes of a block, on any number of processes
//! and machines, and the learner takes their steps in one order.
//!
//! | module | holds |
//! |---|---|
//! | [`coordinate`] | a training with actors |
//! | [`order`] | the episodes of a block, in order; lost, slow and doubled ones |
//! | [`feed`] | steps of separate episodes as the steps of one run |
//! | [`held`] | the end of the last block, from which an interrupted training goes on |
//! | [`pool`], [`connection`] | the learner's side of the connections |
//! | [`children`] | the actors on this machine |
//! | [`door`], [`tls`] | the port for actors of other machines, and its mutual TLS |
//! | [`arguments`], [`actor`], [`drive`], [`remote`] | the actor: `./vlaps actor` |
//! | [`envelope`], [`message`] | frames and their bodies |
//! | [`tally`] | what the actors did |
//!
//! An episode follows from the training's seed, its block and its number, and from the policy
//! of the block. So the policies are the same for any number of actors, whichever of them are
//! slow, die or answer twice.

pub mod actor;
pub mod arguments;
pub mod children;
pub mod connection;
pub mod coordinate;
pub mod door;
pub mod drive;
pub mod envelope;
pub mod feed;
pub mod held;
pub mod message;
pub mod order;
pub mod pool;
pub mod remote;
pub mod tally;
pub mod tls;
