//! Optional parts that need more than a build: MetaDrive, ONNX Runtime, the Python package,
//! programs of a user.

pub mod checkout;
pub mod install;
pub mod metadrive;
pub mod onnxruntime;
pub mod own_programs;
pub mod package;
pub mod pip;
