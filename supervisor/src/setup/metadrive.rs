//! The real MetaDrive as world: where its files and its Python are.

use std::env;
use std::path::{Path, PathBuf};

use crate::cli::failure::Failure;
use crate::machine::programs::own_folder;
use crate::set::launch::Script;

/// Folder of the Python environment, in place of the one beside the build.
pub const HOME_VARIABLE: &str = "VLAPS_METADRIVE";
/// Folder of the repository, as `./vlaps` says it.
const ROOT_VARIABLE: &str = "VLAPS_ROOT";

/// In the environment's folder: what was installed, as required then, and from
/// which checkout. Written when everything has been checked.
pub const DONE: &str = "installed.txt";

/// Where the world's Python files are in the repository.
const SOURCES: &str = "sim/metadrive";

/// The folder of the world's Python files.
///
/// # Errors
/// When it is not where this binary was built, nor where `./vlaps` is.
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

/// The folder of the Python environment, there or not: beside the build's own
/// folder, so that removing all that was built removes it, too.
///
/// # Errors
/// When the system does not tell where this binary is.
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

/// How the world is started.
///
/// # Errors
/// When it is not set up.
pub fn world() -> Result<Script, Failure> {
    let home = home()?;
    let interpreter = python(&home);
    // Written last, so a set-up that was interrupted does not count.
    if !interpreter.is_file() || !home.join(DONE).is_file() {
        return Err(Failure::Usage(format!(
            "{}: MetaDrive is not set up there; run ./vlaps setup metadrive",
            home.display()
        )));
    }
    let file = sources()?.join("world.py");
    Ok(Script { interpreter, file })
}
