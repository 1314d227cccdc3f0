//! Optional parts that need more than a build: MetaDrive, ir-sim, ONNX Runtime, ROS 2, the
//! Python package, programs of a user.

pub mod checkout;
pub mod environment;
pub mod foreign;
pub mod install;
pub mod irsim;
pub mod onnxruntime;
pub mod own_programs;
pub mod package;
pub mod pip;
pub mod ros;
