//! The integration tests of this crate, one program: each program is linked anew.

mod advice;
mod bodies;
mod judge;
mod net;
mod picture;
mod records;
mod shared;
mod store;
