//! setup

pub mod checkout;
pub mod install;
pub mod metadrive;
pub mod onnxruntime;
