//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p planner --test all NAME::` runs those of one file.

mod arc;
mod course;
mod driving;
mod dubins;
mod goal;
mod grid;
mod informed;
mod kinodynamic;
mod limits;
mod mpc;
mod plan;
mod reference;
mod tree;
mod unseen;
