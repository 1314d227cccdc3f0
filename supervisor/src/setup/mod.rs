//! Optional parts that need more than a build: simulators as worlds, ONNX Runtime, ROS 2,
//! the Python package, programs of a user.

pub mod checkout;
pub mod environment;
pub mod foreign;
pub mod onnxruntime;
pub mod own_programs;
pub mod package;
pub mod pip;
pub mod ros;
pub mod world;
