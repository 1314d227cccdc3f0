//! `setup onnxruntime`: installs the library that runs policies which are not a chain
//! of layers, from its Python package.

use std::path::Path;
use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::setup::foreign::beside_the_build;
use crate::setup::pip::{last_line, output_of};

/// The package in the version for which the controller is built.
const PACKAGE: &str = "onnxruntime==1.31.1";
/// The path of the library in it.
const LIBRARY: &str = "onnxruntime/capi";

/// Installs the package into a folder of its own, if it is not there.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup(python: Option<&Path>) -> Result<(), Failure> {
    // Beside the build's own folder, where the controller expects it.
    let home = beside_the_build("onnxruntime")?;
    if !has_library(&home) {
        let python = python.unwrap_or(Path::new("python3"));
        say(format_args!("installing {PACKAGE} into {}", home.display()));
        let install = ["-m", "pip", "install", "--quiet", "--no-deps", "--target"];
        let mut command = Command::new(python);
        command.args(install).arg(&home).arg(PACKAGE);
        let output = output_of(&mut command)?;
        if !output.status.success() || !has_library(&home) {
            return Err(Failure::GivenUp(format!(
                "cannot install {PACKAGE}: {}; check the network and, behind a proxy or mirror, \
                 `pip config list`, then run ./vlaps setup onnxruntime again",
                last_line(&output)
            )));
        }
    }
    say(format_args!(
        "ready: {}; policies of any allowed operator can be run",
        home.display()
    ));
    Ok(())
}

fn has_library(home: &Path) -> bool {
    let entries = std::fs::read_dir(home.join(LIBRARY));
    entries.into_iter().flatten().flatten().any(|entry| {
        let name = entry.file_name();
        name.to_string_lossy().starts_with("libonnxruntime.so")
    })
}
