//! cli

pub mod failure;
pub mod output;
pub mod parsers;
