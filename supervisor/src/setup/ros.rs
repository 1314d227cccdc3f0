//! `setup ros`, `setup link`: build the programs of `ros/` and `link/`, workspaces of their own.

use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::setup::environment::Steps;
use crate::setup::foreign::{beside_the_build, root};

/// Builds `vlaps-ros` and `vlaps-ros-world`.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup() -> Result<(), Failure> {
    build("ros")?;
    say("ready: target/release/vlaps-ros RUN, ./vlaps up --world target/release/vlaps-ros-world");
    Ok(())
}

/// Builds `vlaps-link` and the programs that stand for processes of other machines.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup_link() -> Result<(), Failure> {
    build("link")?;
    say("ready: ./vlaps link invite, ./vlaps up --judge HOST:PORT, ./vlaps join");
    Ok(())
}

/// Builds a workspace of its own into the build's own folder, so that what the workspaces
/// have in common is compiled once.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
fn build(workspace: &'static str) -> Result<(), Failure> {
    say("building Zenoh and the programs; the first time takes some minutes");
    Steps(workspace).run(
        Command::new("cargo")
            .args(["build", "--release", "--quiet", "--locked", "--bins"])
            .arg("--manifest-path")
            .arg(root()?.join(workspace).join("Cargo.toml"))
            .arg("--target-dir")
            .arg(beside_the_build("")?)
            .env("CARGO_INCREMENTAL", "0"),
        &format!("cannot build {workspace}/"),
        "check that cargo is on PATH and reaches its registry",
    )?;
    Ok(())
}
