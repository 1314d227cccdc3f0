//! Python environments of a set-up, and its steps.

use std::path::Path;
use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
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

/// Makes a Python environment with the wanted Python, or with python3, which has to be of
/// a version at least.
///
/// # Errors
/// When there is no such Python, or it cannot make one.
pub(crate) fn make_environment(
    steps: Steps,
    (wanted, (major, minor)): (Option<&Path>, (u32, u32)),
    home: &Path,
) -> Result<(), Failure> {
    let base = wanted.unwrap_or(Path::new("python3"));
    let least = format!(
        "import sys; sys.exit(sys.version_info < ({major}, {minor}) and 'Python {major}.{minor} \
         or later is needed, and this is ' + sys.version.split()[0])"
    );
    let advice =
        "name another Python with --python FILE; on Debian, python3-venv must be installed";
    let what = format!("{} cannot be used", base.display());
    steps.run(Command::new(base).args(["-c", &least]), &what, advice)?;
    say(format_args!(
        "making a Python environment in {} with {}",
        home.display(),
        base.display()
    ));
    let what = format!("{}: cannot make a Python environment", home.display());
    steps.run(
        Command::new(base).args(["-m", "venv"]).arg(home),
        &what,
        advice,
    )?;
    Ok(())
}
