//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p gate --test all NAME::` runs those of one file.

mod advice;
mod bodies;
mod judge;
mod net;
mod picture;
mod records;
mod shared;
mod store;
