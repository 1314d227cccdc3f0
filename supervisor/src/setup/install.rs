//! `setup`: a Python environment with the real MetaDrive, ready to be a world.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::setup::checkout::{Checkout, installed};
use crate::setup::foreign::{DONE, METADRIVE, python};
use crate::setup::pip::{last_line, output_of};

/// The only Python version that has packages of MetaDrive's graphics engine and can
/// read TOML.
const PYTHON_VERSION: &str = "3.11";
/// The line of MetaDrive in the requirements.
const RELEASE: &str = "metadrive-simulator";

/// Installs MetaDrive into its Python environment, as far as it is missing, and checks it:
/// one reset and one step.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn install_metadrive(wanted: Option<&Path>, checkout: Option<&Path>) -> Result<(), Failure> {
    let checkout = checkout.map(Checkout::open).transpose()?;
    let (sources, home) = (METADRIVE.sources()?, METADRIVE.home()?);
    let required = sources.join("requirements.txt");
    let required_text = fs::read_to_string(&required)
        .map_err(|error| Failure::GivenUp(format!("{}: {error}", required.display())))?;
    let record = match &checkout {
        None => required_text.clone(),
        Some(checkout) => format!(
            "{required_text}\n# In place of {RELEASE}, a checkout: {}\n",
            checkout.identity()
        ),
    };
    let done = home.join(DONE);
    let interpreter = python(&home);
    if interpreter.is_file() && fs::read_to_string(&done).ok().as_ref() == Some(&record) {
        say(format_args!("{}: installed already", home.display()));
    } else {
        // Until the last step has succeeded, MetaDrive counts as not set up.
        let _ = fs::remove_file(&done);
        make_environment(wanted, &home, &interpreter)?;
        install(&home, &required_text, checkout.as_ref())?;
    }
    say("checking: assets, one reset, one step");
    let prepare = sources.join("prepare.py");
    let output = output_of(Command::new(&interpreter).arg(&prepare))?;
    if !output.status.success() {
        return Err(Failure::GivenUp(format!(
            "MetaDrive does not run: {}; remove {} and run ./vlaps setup metadrive again",
            last_line(&output),
            home.display()
        )));
    }
    say(String::from_utf8_lossy(&output.stdout).trim());
    fs::write(&done, record)
        .map_err(|error| Failure::GivenUp(format!("{}: {error}", done.display())))?;
    say("ready: ./vlaps up --world metadrive");
    Ok(())
}

fn make_environment(wanted: Option<&Path>, home: &Path, interpreter: &Path) -> Result<(), Failure> {
    if interpreter.is_file() {
        say(format_args!(
            "{}: a Python environment is there",
            home.display()
        ));
        return Ok(());
    }
    let base = find_python(wanted)?;
    say(format_args!(
        "making a Python environment in {} with {}",
        home.display(),
        base.display()
    ));
    let output = output_of(Command::new(&base).args(["-m", "venv"]).arg(home))?;
    match output.status.success() {
        true => Ok(()),
        false => Err(Failure::GivenUp(format!(
            "{}: cannot make a Python environment: {}; on Debian, python{PYTHON_VERSION}-venv \
             must be installed",
            home.display(),
            last_line(&output)
        ))),
    }
}

/// Installs the requirements, with MetaDrive from the checkout if there is one. An
/// earlier MetaDrive is removed first, because pip does not know of a copied one.
fn install(home: &Path, required: &str, checkout: Option<&Checkout>) -> Result<(), Failure> {
    let interpreter = python(home);
    let packages = home.join(format!("lib/python{PYTHON_VERSION}/site-packages"));
    let uninstall = ["-m", "pip", "uninstall", "--quiet", "--yes", RELEASE];
    output_of(Command::new(&interpreter).args(uninstall))?;
    let package = installed(&packages);
    if package.exists() {
        fs::remove_dir_all(&package)
            .map_err(|error| Failure::GivenUp(format!("{}: {error}", package.display())))?;
    }
    let mut lines: Vec<&str> = required.lines().collect();
    let from = match checkout {
        None => RELEASE.to_string(),
        Some(checkout) => {
            lines.retain(|line| !line.starts_with(RELEASE));
            format!("MetaDrive of a checkout ({})", checkout.identity())
        }
    };
    say(format_args!(
        "installing {from}, iceoryx2 and what they need; this takes some minutes"
    ));
    let list = home.join("requirements.txt");
    fs::write(&list, lines.join("\n"))
        .map_err(|error| Failure::GivenUp(format!("{}: {error}", list.display())))?;
    let output = output_of(
        Command::new(&interpreter)
            .args(["-m", "pip", "install", "--quiet", "--requirement"])
            .arg(&list),
    )?;
    if !output.status.success() {
        return Err(Failure::GivenUp(format!(
            "cannot install {}: {}; check the network and, behind a proxy or mirror, \
             `pip config list`, then run ./vlaps setup metadrive again",
            list.display(),
            last_line(&output)
        )));
    }
    match checkout {
        None => Ok(()),
        Some(checkout) => checkout.copy_into(&packages),
    }
}

/// Finds a Python of the right version.
fn find_python(wanted: Option<&Path>) -> Result<PathBuf, Failure> {
    let exact = format!("python{PYTHON_VERSION}");
    let candidates = match wanted {
        Some(path) => vec![path.to_path_buf()],
        None => vec![exact.into(), "python3".into(), "python".into()],
    };
    let mut found = Vec::new();
    for candidate in candidates {
        if let Some(version) = version_of(&candidate) {
            if version == PYTHON_VERSION {
                return Ok(candidate);
            }
            found.push(format!("{} is {version}", candidate.display()));
        }
    }
    let found = match found.as_slice() {
        [] => "none was found".into(),
        found => found.join(", "),
    };
    Err(Failure::Usage(format!(
        "MetaDrive needs Python {PYTHON_VERSION}, and {found}; install it, or name it with \
         --python FILE"
    )))
}

/// The version, such as `3.11`; `None` when the program does not run.
fn version_of(python: &Path) -> Option<String> {
    let ask = "import sys; print('%d.%d' % sys.version_info[:2])";
    let output = Command::new(python).args(["-c", ask]).output().ok()?;
    let version = String::from_utf8(output.stdout).ok()?;
    Some(version.trim().to_string()).filter(|version| !version.is_empty())
}
