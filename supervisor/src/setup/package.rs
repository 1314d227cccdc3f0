//! `setup python`: the Python package `vlaps` in an environment of its own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::setup::environment::{Steps, make_environment};
use crate::setup::foreign::{Version, beside_the_build, python, root};

/// What builds, runs and tests the package.
const REQUIRED: [&str; 4] = [
    "maturin>=1.16,<2",
    "numpy>=1.26",
    "gymnasium>=1.1",
    "pytest",
];
/// One step of one environment, which also compares the interpreter with the least one.
const CHECK: &str = "import sys, vlaps; env = vlaps.MetaDriveEnv(); env.reset(seed=0); \
     env.step([0.0, 0.5]); print('vlaps', vlaps.__version__, 'on Python', sys.version.split()[0])";
/// The first Python that the package is built for.
const LEAST: Version = Version::Least(3, 10);
const STEPS: Steps = Steps("python");

/// Builds the package's wheel and installs it with what it needs.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup(wanted: Option<&Path>) -> Result<(), Failure> {
    let home = beside_the_build("python")?;
    let manifest = root()?.join("python/Cargo.toml");
    let interpreter = python(&home);
    if !interpreter.is_file() {
        make_environment(STEPS, (wanted, LEAST), &home)?;
    }
    say("installing maturin, numpy, gymnasium and pytest");
    let pip = ["-m", "pip", "install", "--quiet"];
    let advice = "check the network and, behind a proxy or mirror, `pip config list`";
    STEPS.run(
        Command::new(&interpreter).args(pip).args(REQUIRED),
        "cannot install what the package needs",
        advice,
    )?;
    say("building the package; this takes a minute");
    let wheels = home.join("wheels");
    // Only the wheel of this build is installed.
    let _ = fs::remove_dir_all(&wheels);
    STEPS.run(
        Command::new(&interpreter)
            .args([
                "-m",
                "maturin",
                "build",
                "--release",
                "--quiet",
                "--manifest-path",
            ])
            .arg(&manifest)
            .arg("--out")
            .arg(&wheels)
            .env("CARGO_INCREMENTAL", "0"),
        "cannot build the wheel",
        "check that cargo is on PATH",
    )?;
    STEPS.run(
        Command::new(&interpreter)
            .args(pip)
            .args(["--force-reinstall", "--no-deps"])
            .args(files_of(&wheels)?),
        "cannot install the wheel",
        advice,
    )?;
    let output = STEPS.run(
        Command::new(&interpreter).args(["-c", CHECK]),
        "the package does not run",
        "remove target/python",
    )?;
    say(output.trim());
    say(format_args!("ready: {}", interpreter.display()));
    Ok(())
}

fn files_of(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let unreadable =
        |error: std::io::Error| Failure::GivenUp(format!("{}: {error}", folder.display()));
    let entries = fs::read_dir(folder).map_err(unreadable)?;
    entries
        .map(|entry| entry.map(|entry| entry.path()).map_err(unreadable))
        .collect()
}
