//! The integration tests of this crate, in one program, since each program links all
//! libraries again. `cargo test -p controller --test all NAME::` runs those of one file.

mod canary;
#[path = "../../policy/tests/convolved/mod.rs"]
mod convolved;
mod late;
mod motion;
mod onnxruntime;
mod recompute;
mod recorded;
mod road;
mod takeover;
mod tick;
#[path = "../../policy/tests/torch/mod.rs"]
mod torch;
mod transfer;
