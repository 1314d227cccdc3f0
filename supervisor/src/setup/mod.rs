//! Optional parts that need more than a build: MetaDrive, ONNX Runtime, the Python package.

pub mod checkout;
pub mod install;
pub mod metadrive;
pub mod onnxruntime;
pub mod package;
pub mod pip;
