//! `setup ir-sim`: a Python environment with ir-sim, and the library of its world.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::setup::environment::{Steps, make_environment};
use crate::setup::foreign::{DONE, IR_SIM, python, root};

/// The first Python for which the pinned packages exist.
const LEAST: (u32, u32) = (3, 11);
const STEPS: Steps = Steps(IR_SIM.part);

/// Builds libvlaps, installs ir-sim into its Python environment, as far as it is missing,
/// and checks both: one scene and one step.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup(wanted: Option<&Path>) -> Result<(), Failure> {
    let (home, sources) = (IR_SIM.home()?, IR_SIM.sources()?);
    say("building libvlaps, by which the world joins a run");
    STEPS.run(
        Command::new("cargo")
            .args([
                "build",
                "--release",
                "--quiet",
                "--package",
                "capi",
                "--manifest-path",
            ])
            .arg(root().join("Cargo.toml"))
            .env("CARGO_INCREMENTAL", "0"),
        "cannot build libvlaps",
        "check that cargo is on PATH",
    )?;
    let required = sources.join("requirements.txt");
    let record = fs::read_to_string(&required)
        .map_err(|error| Failure::GivenUp(format!("{}: {error}", required.display())))?;
    let (done, interpreter) = (home.join(DONE), python(&home));
    if interpreter.is_file() && fs::read_to_string(&done).ok().as_ref() == Some(&record) {
        say(format_args!("{}: installed already", home.display()));
    } else {
        // Until the last step has succeeded, ir-sim counts as not set up.
        let _ = fs::remove_file(&done);
        if !interpreter.is_file() {
            make_environment(STEPS, (wanted, LEAST), &home)?;
        }
        say("installing ir-sim and what it needs; this takes a minute");
        STEPS.run(
            Command::new(&interpreter)
                .args(["-m", "pip", "install", "--quiet", "--requirement"])
                .arg(&required),
            "cannot install ir-sim",
            "check the network and, behind a proxy or mirror, `pip config list`",
        )?;
    }
    say("checking: one scene, one step");
    let output = STEPS.run(
        Command::new(&interpreter).arg(sources.join("check.py")),
        "ir-sim does not run",
        &format!("remove {}", home.display()),
    )?;
    say(output.trim());
    fs::write(&done, record)
        .map_err(|error| Failure::GivenUp(format!("{}: {error}", done.display())))?;
    say("ready: ./vlaps up --world ir-sim --vehicle vehicles/car-1-10.toml");
    Ok(())
}
