//! Python environments of a set-up, and its steps.

use std::path::{Path, PathBuf};
use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::setup::foreign::Version;
use crate::setup::pip::{last_line, output_of};

/// The steps of the set-up of a part, which is named by its word.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Steps(pub &'static str);

impl Steps {
    /// Runs a step and returns its output.
    ///
    /// # Errors
    /// One line with what failed, why, and what to do.
    pub fn run(self, command: &mut Command, what: &str, advice: &str) -> Result<String, Failure> {
        let output = output_of(command)?;
        match output.status.success() {
            true => Ok(String::from_utf8_lossy(&output.stdout).into_owned()),
            false => Err(Failure::GivenUp(format!(
                "{what}: {}; {advice}, then run ./vlaps setup {} again",
                last_line(&output),
                self.0
            ))),
        }
    }
}

/// Makes a Python environment with the wanted Python, or with the first on PATH that is of
/// the right version.
///
/// # Errors
/// When there is no such Python, or it cannot make one.
pub(crate) fn make_environment(
    steps: Steps,
    (wanted, version): (Option<&Path>, Version),
    home: &Path,
) -> Result<(), Failure> {
    let base = find_python(wanted, version)?;
    say(format_args!(
        "making a Python environment in {} with {}",
        home.display(),
        base.display()
    ));
    let what = format!("{}: cannot make a Python environment", home.display());
    steps.run(
        Command::new(base).args(["-m", "venv"]).arg(home),
        &what,
        "on Debian, python3-venv must be installed",
    )?;
    Ok(())
}

/// Finds a Python of the right version.
fn find_python(wanted: Option<&Path>, version: Version) -> Result<PathBuf, Failure> {
    let (Version::Exactly(major, minor) | Version::Least(major, minor)) = version;
    let named = PathBuf::from(format!("python{major}.{minor}"));
    let candidates = match wanted {
        Some(path) => vec![path.to_path_buf()],
        None => vec!["python3".into(), named, "python".into()],
    };
    let mut found = Vec::new();
    for candidate in candidates {
        let Some(has) = version_of(&candidate) else {
            continue;
        };
        let fits = match version {
            Version::Exactly(..) => has == (major, minor),
            Version::Least(..) => has >= (major, minor),
        };
        if fits {
            return Ok(candidate);
        }
        found.push(format!("{} is {}.{}", candidate.display(), has.0, has.1));
    }
    let found = match found.as_slice() {
        [] => "none was found".into(),
        found => found.join(", "),
    };
    let later = match version {
        Version::Exactly(..) => "",
        Version::Least(..) => " or later",
    };
    Err(Failure::Usage(format!(
        "Python {major}.{minor}{later} is needed, and {found}; install it, or name it with \
         --python FILE"
    )))
}

/// The version, such as 3 and 11; `None` when the program does not run.
fn version_of(python: &Path) -> Option<(u32, u32)> {
    let ask = "import sys; print(*sys.version_info[:2])";
    let output = Command::new(python).args(["-c", ask]).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let (major, minor) = text.trim().split_once(' ')?;
    Some((major.parse().ok()?, minor.parse().ok()?))
}
