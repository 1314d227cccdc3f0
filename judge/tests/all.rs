//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p judge --test all NAME::` runs those of one file.

mod asking;
mod audit;
mod distil;
mod faults;
mod https;
#[path = "../../gate/tests/records/mod.rs"]
mod records;
mod replay;
mod secrets;
#[path = "../../gate/tests/shared/mod.rs"]
mod shared;
