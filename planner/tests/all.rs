//! The integration tests of this crate, one program: each program is linked anew.

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
