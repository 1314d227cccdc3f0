//! The integration tests of this crate, one program: each program is linked anew.

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
