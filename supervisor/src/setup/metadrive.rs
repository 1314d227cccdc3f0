//! The real MetaDrive as world: where its files and its Python are.

use std::env;
use std::path::{Path, PathBuf};

use shm_config::services::Process;

use crate::cli::failure::Failure;
use crate::machine::programs::own_folder;
use crate::set::launch::Program;

/// The variable that names another folder of the Python environment.
pub const HOME_VARIABLE: &str = "VLAPS_METADRIVE";
/// The variable with the folder of the repository, which `./vlaps` sets.
const ROOT_VARIABLE: &str = "VLAPS_ROOT";

/// The file in the environment's folder that lists the installed requirements and the
/// checkout. It is written after all checks.
pub const DONE: &str = "installed.txt";

/// Where the world's Python files are in the repository.
const SOURCES: &str = "sim/metadrive";

/// The folder of the world's Python files.
///
/// # Errors
/// When they are neither where this binary was built nor where `./vlaps` is.
pub fn sources() -> Result<PathBuf, Failure> {
    let root = match env::var_os(ROOT_VARIABLE) {
        Some(root) => PathBuf::from(root),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join(".."),
    };
    let sources = root.join(SOURCES);
    match sources.join("world.py").is_file() {
        true => Ok(sources),
        false => Err(Failure::Usage(format!(
            "{}: the world's Python files are missing; start it with ./vlaps of the repository",
            sources.display()
        ))),
    }
}

/// The folder of the Python environment, whether it exists or not: beside the build's
/// own folder, so that removing the build removes it too.
///
/// # Errors
/// When the system does not report where this binary is.
pub fn home() -> Result<PathBuf, Failure> {
    if let Some(home) = env::var_os(HOME_VARIABLE) {
        return Ok(home.into());
    }
    let release = own_folder()
        .map_err(|error| Failure::GivenUp(format!("cannot find the build's folder: {error}")))?;
    Ok(release.parent().unwrap_or(&release).join("metadrive"))
}

/// Its Python.
pub fn python(home: &Path) -> PathBuf {
    home.join("bin").join("python")
}

/// The command that starts the world.
///
/// # Errors
/// When it is not set up.
pub fn world() -> Result<Program, Failure> {
    let home = home()?;
    let path = python(&home);
    // Written last, so an interrupted set-up does not count.
    if !path.is_file() || !home.join(DONE).is_file() {
        return Err(Failure::Usage(format!(
            "{}: MetaDrive is not set up there; run ./vlaps setup metadrive",
            home.display()
        )));
    }
    Ok(Program {
        process: Process::World,
        path,
        script: Some(sources()?.join("world.py")),
    })
}
