//! `setup ros`: builds the programs of `ros/`, a workspace of its own.

use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::setup::environment::Steps;
use crate::setup::foreign::{beside_the_build, root};

const STEPS: Steps = Steps("ros");

/// Builds `vlaps-ros` and `vlaps-ros-world` into the build's own folder, so that what both
/// workspaces have in common is compiled once.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup() -> Result<(), Failure> {
    say("building Zenoh and both programs; the first time takes some minutes");
    STEPS.run(
        Command::new("cargo")
            .args(["build", "--release", "--quiet", "--locked", "--bins"])
            .arg("--manifest-path")
            .arg(root()?.join("ros").join("Cargo.toml"))
            .arg("--target-dir")
            .arg(beside_the_build("")?)
            .env("CARGO_INCREMENTAL", "0"),
        "cannot build ros/",
        "check that cargo is on PATH and reaches its registry",
    )?;
    say("ready: target/release/vlaps-ros RUN, ./vlaps up --world target/release/vlaps-ros-world");
    Ok(())
}
