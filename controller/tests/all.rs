//! The integration tests of this crate, one program: each program is linked anew.

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
