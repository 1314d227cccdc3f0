//! `setup` of a simulator: its Python environment, ready to be a world.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::cli::failure::Failure;
use crate::cli::print::say;
use crate::setup::checkout::Checkout;
use crate::setup::environment::{Steps, make_environment};
use crate::setup::foreign::{DONE, Foreign, Origin, Source, python, root};

/// The file in the environment's folder with the folder of a checkout that is read where it
/// is.
const CHECKOUT: &str = "checkout.txt";

/// Installs a simulator into its Python environment, as far as it is missing, and checks it:
/// one step.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup(row: &Foreign, wanted: Option<&Path>, checkout: Option<&Path>) -> Result<(), Failure> {
    let (steps, part) = (Steps(row.part()), row.part());
    let (home, sources) = (row.home()?, row.sources()?);
    let checkout = opened(row, checkout, &home)?;
    if row.is_on_library {
        build_library(steps)?;
    }
    let required = sources.join("requirements.txt");
    let required = fs::read_to_string(&required).map_err(|error| failed(&required, &error))?;
    let record = match &checkout {
        None => required.clone(),
        Some(checkout) => format!("{required}\n# A checkout: {}\n", checkout.identity()),
    };
    let (done, interpreter) = (home.join(DONE), python(&home));
    let has_all = interpreter.is_file() && fs::read_to_string(&done).ok().as_ref() == Some(&record);
    // Until the last step has succeeded, it counts as not set up.
    let _ = fs::remove_file(&done);
    if has_all {
        say(format_args!("{}: installed already", home.display()));
    } else {
        if !interpreter.is_file() {
            make_environment(steps, (wanted, row.python), &home)?;
        }
        install(row, &home, &required, checkout.as_ref())?;
    }
    if let (Origin::Checkout(_), Some(checkout)) = (row.origin, &checkout) {
        let at = home.join(CHECKOUT);
        let folder = checkout.folder().display().to_string();
        fs::write(&at, folder).map_err(|error| failed(&at, &error))?;
    }
    say("checking: one step");
    let output = steps.run(
        Command::new(&interpreter).arg(sources.join("check.py")),
        &format!("{} does not run", row.name),
        &format!("remove {}", home.display()),
    )?;
    say(output.trim());
    fs::write(&done, record).map_err(|error| failed(&done, &error))?;
    say(format_args!(
        "ready: ./vlaps up --world {part}{}",
        row.first_drive
    ));
    Ok(())
}

fn failed(path: &Path, error: &std::io::Error) -> Failure {
    Failure::GivenUp(format!("{}: {error}", path.display()))
}

/// The checkout that is given, or that an earlier setup was given where one is needed.
fn opened(row: &Foreign, given: Option<&Path>, home: &Path) -> Result<Option<Checkout>, Failure> {
    let part = row.part();
    match (row.origin, given) {
        (Origin::Package, Some(_)) => Err(Failure::Usage(format!(
            "--checkout: {part} is installed from its package alone"
        ))),
        (Origin::Package | Origin::PackageOrCopy(_), None) => Ok(None),
        (Origin::PackageOrCopy(source) | Origin::Checkout(source), Some(folder)) => {
            Checkout::open(&source, folder).map(Some)
        }
        (Origin::Checkout(source), None) => match fs::read_to_string(home.join(CHECKOUT)) {
            Ok(folder) => Checkout::open(&source, Path::new(folder.trim())).map(Some),
            Err(_) => Err(Failure::Usage(format!(
                "{} needs files that no package has: run `git clone https://{}` and name its \
                 folder: ./vlaps setup {part} --checkout DIR",
                row.name, source.address
            ))),
        },
    }
}

fn build_library(steps: Steps) -> Result<(), Failure> {
    say("building libvlaps, by which the world joins a run");
    let arguments = ["build", "--release", "--quiet", "--package", "capi"];
    steps.run(
        Command::new("cargo")
            .args(arguments)
            .arg("--manifest-path")
            .arg(root()?.join("Cargo.toml"))
            .env("CARGO_INCREMENTAL", "0"),
        "cannot build libvlaps",
        "check that cargo is on PATH",
    )?;
    Ok(())
}

/// Installs the requirements; in place of the simulator's release a checkout, if there is
/// one. What an earlier checkout left is removed, because pip does not know of it.
fn install(
    row: &Foreign,
    home: &Path,
    required: &str,
    checkout: Option<&Checkout>,
) -> Result<(), Failure> {
    let (steps, interpreter) = (Steps(row.part()), python(home));
    let mut lines: Vec<&str> = required.lines().collect();
    let mut copied = None;
    if let Origin::PackageOrCopy(source) = row.origin {
        let packages = packages(steps, &interpreter)?;
        remove(steps, &interpreter, &source, &packages)?;
        if let Some(checkout) = checkout {
            lines.retain(|line| !line.starts_with(source.release));
            copied = Some((checkout, packages));
        }
    }
    say(format_args!(
        "installing {} and what it needs; this takes some minutes",
        row.name
    ));
    let list = home.join("requirements.txt");
    fs::write(&list, lines.join("\n")).map_err(|error| failed(&list, &error))?;
    steps.run(
        Command::new(&interpreter)
            .args(["-m", "pip", "install", "--quiet", "--requirement"])
            .arg(&list),
        &format!("cannot install {}", list.display()),
        "check the network and, behind a proxy or mirror, `pip config list`",
    )?;
    copied.map_or(Ok(()), |(checkout, packages)| checkout.copy_into(&packages))
}

/// Where an environment has its packages.
fn packages(steps: Steps, interpreter: &Path) -> Result<PathBuf, Failure> {
    let ask = "import sysconfig; print(sysconfig.get_path('purelib'))";
    let output = steps.run(
        Command::new(interpreter).args(["-c", ask]),
        &format!("{} does not run", interpreter.display()),
        "remove its environment",
    )?;
    Ok(PathBuf::from(output.trim()))
}

/// Removes an earlier release or copy.
fn remove(
    steps: Steps,
    interpreter: &Path,
    source: &Source,
    packages: &Path,
) -> Result<(), Failure> {
    let uninstall = ["-m", "pip", "uninstall", "--quiet", "--yes", source.release];
    steps.run(
        Command::new(interpreter).args(uninstall),
        &format!("cannot remove an earlier {}", source.release),
        "remove its environment",
    )?;
    let package = packages.join(source.package);
    match package.exists() {
        true => fs::remove_dir_all(&package).map_err(|error| failed(&package, &error)),
        false => Ok(()),
    }
}
