//! Optional parts that need more than a build: MetaDrive, ONNX Runtime.

pub mod checkout;
pub mod install;
pub mod metadrive;
pub mod onnxruntime;
pub mod pip;
