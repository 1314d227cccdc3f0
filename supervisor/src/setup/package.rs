//! `setup python`: the Python package `vlaps` in an environment of its own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::machine::programs::own_folder;
use crate::setup::metadrive::{python, sources};
use crate::setup::pip::{last_line, output_of};

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
/// Fails on a Python that the package is not built for.
const LEAST: &str = "import sys; sys.exit(sys.version_info < (3, 10) and 'Python 3.10 or later is \
     needed, and this is ' + sys.version.split()[0])";

/// Builds the package's wheel and installs it with what it needs.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup(wanted: Option<&Path>) -> Result<(), Failure> {
    let home = home()?;
    let manifest = sources()?.join("../../python/Cargo.toml");
    let interpreter = python(&home);
    if !interpreter.is_file() {
        make_environment(wanted.unwrap_or(Path::new("python3")), &home)?;
    }
    say("installing maturin, numpy, gymnasium and pytest");
    let pip = ["-m", "pip", "install", "--quiet"];
    let advice = "check the network and, behind a proxy or mirror, `pip config list`";
    step(
        Command::new(&interpreter).args(pip).args(REQUIRED),
        "cannot install what the package needs",
        advice,
    )?;
    say("building the package; this takes a minute");
    let wheels = home.join("wheels");
    // Only the wheel of this build is installed.
    let _ = fs::remove_dir_all(&wheels);
    step(
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
    step(
        Command::new(&interpreter)
            .args(pip)
            .args(["--force-reinstall", "--no-deps"])
            .args(files_of(&wheels)?),
        "cannot install the wheel",
        advice,
    )?;
    let output = step(
        Command::new(&interpreter).args(["-c", CHECK]),
        "the package does not run",
        "remove target/python",
    )?;
    say(output.trim());
    say(format_args!("ready: {}", interpreter.display()));
    Ok(())
}

/// The folder of the environment: beside the build's own folder.
fn home() -> Result<PathBuf, Failure> {
    let release = own_folder()
        .map_err(|error| Failure::GivenUp(format!("cannot find the build's folder: {error}")))?;
    Ok(release.parent().unwrap_or(&release).join("python"))
}

fn make_environment(base: &Path, home: &Path) -> Result<(), Failure> {
    let advice =
        "name another Python with --python FILE; on Debian, python3-venv must be installed";
    let what = format!("{} cannot be used", base.display());
    step(Command::new(base).args(["-c", LEAST]), &what, advice)?;
    say(format_args!(
        "making a Python environment in {} with {}",
        home.display(),
        base.display()
    ));
    let what = format!("{}: cannot make a Python environment", home.display());
    step(
        Command::new(base).args(["-m", "venv"]).arg(home),
        &what,
        advice,
    )?;
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

/// Runs a step and returns its output.
fn step(command: &mut Command, what: &str, advice: &str) -> Result<String, Failure> {
    let output = output_of(command)?;
    match output.status.success() {
        true => Ok(String::from_utf8_lossy(&output.stdout).into_owned()),
        false => Err(Failure::GivenUp(format!(
            "{what}: {}; {advice}, then run ./vlaps setup python again",
            last_line(&output)
        ))),
    }
}
