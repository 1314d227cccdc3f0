//! Builds the program of `bench/zenoh` with Zenoh from the package registry.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::Context;
use supervisor::cli::failure::Failure;
use supervisor::cli::print::say;

use super::{Message, Other, Program};

/// The package, relative to the checkout.
const PACKAGE: &str = "bench/zenoh";
/// Version of Zenoh that the package's manifest pins.
const VERSION: &str = "1.10.2";

/// Builds the program into `target/zenoh` and keeps it: the first build takes minutes.
pub fn build() -> anyhow::Result<Program> {
    let root = PathBuf::from(std::env::var_os("VLAPS_ROOT").unwrap_or_else(|| ".".into()));
    let manifest = root.join(PACKAGE).join("Cargo.toml");
    if !manifest.is_file() {
        return Err(Failure::GivenUp(format!(
            "--zenoh: {} is missing; run it by ./vlaps of a checkout",
            manifest.display()
        ))
        .into());
    }
    let release =
        supervisor::machine::programs::own_folder().context("--zenoh: the build's folder")?;
    let target = release.parent().unwrap_or(Path::new(".")).join("zenoh");
    say(format_args!("building {PACKAGE} into {}", target.display()));
    let built = Command::new("cargo")
        .args(["build", "--release", "--locked", "--manifest-path"])
        .arg(&manifest)
        .arg("--target-dir")
        .arg(&target)
        .stdin(Stdio::null())
        .status()
        .context("--zenoh: cargo")?;
    if !built.success() {
        return Err(Failure::GivenUp(format!(
            "--zenoh: {PACKAGE} does not build; cargo's errors are above"
        ))
        .into());
    }
    Ok(Program {
        other: Other {
            name: "zenoh",
            version: VERSION.into(),
        },
        binary: target.join("release/vlaps-zenoh"),
        message: Message::Bytes,
        environment: None,
        _folder: None,
    })
}
