//! Simulators whose world is a program in Python: where its files and its Python are.

use std::env;
use std::path::{Path, PathBuf};

use shm_config::config::Simulator;
use shm_config::services::Process;

use crate::cli::failure::Failure;
use crate::machine::programs::own_folder;
use crate::set::launch::Program;

/// The variable with the folder of the repository, which `./vlaps` sets.
const ROOT_VARIABLE: &str = "VLAPS_ROOT";

/// The file in the environment's folder that lists the installed requirements and the
/// checkout. It is written after all checks.
pub const DONE: &str = "installed.txt";

/// A simulator that is installed into a Python environment of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Foreign {
    /// Its name in sentences.
    pub name: &'static str,
    /// Its word in `./vlaps setup`, and the name of its folder beside the build's.
    pub part: &'static str,
    /// The variable that names another folder of the Python environment.
    pub home_variable: &'static str,
    /// Where the world's Python files are in the repository.
    folder: &'static str,
}

/// The real MetaDrive.
pub const METADRIVE: Foreign = Foreign {
    name: "MetaDrive",
    part: "metadrive",
    home_variable: "VLAPS_METADRIVE",
    folder: "sim/metadrive",
};

/// ir-sim.
pub const IR_SIM: Foreign = Foreign {
    name: "ir-sim",
    part: "ir-sim",
    home_variable: "VLAPS_IR_SIM",
    folder: "sim/irsim",
};

impl Foreign {
    /// The one that a world needs; `None` for the built-in world.
    pub fn of(simulator: Simulator) -> Option<Self> {
        match simulator {
            Simulator::BuiltIn => None,
            Simulator::MetaDrive => Some(METADRIVE),
            Simulator::IrSim => Some(IR_SIM),
        }
    }

    /// The folder of the world's Python files.
    ///
    /// # Errors
    /// When they are neither where this binary was built nor where `./vlaps` is.
    pub fn sources(&self) -> Result<PathBuf, Failure> {
        let sources = root().join(self.folder);
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
    pub fn home(&self) -> Result<PathBuf, Failure> {
        match env::var_os(self.home_variable) {
            Some(home) => Ok(home.into()),
            None => beside_the_build(self.part),
        }
    }

    /// The command that starts the world.
    ///
    /// # Errors
    /// When it is not set up.
    pub fn world(&self) -> Result<Program, Failure> {
        let home = self.home()?;
        let path = python(&home);
        // Written last, so an interrupted set-up does not count.
        if !path.is_file() || !home.join(DONE).is_file() {
            return Err(Failure::Usage(format!(
                "{}: {} is not set up there; run ./vlaps setup {}",
                home.display(),
                self.name,
                self.part
            )));
        }
        Ok(Program {
            process: Process::World,
            path,
            script: Some(self.sources()?.join("world.py")),
        })
    }
}

/// The folder of the repository: that of `./vlaps`, else the one that this was built from.
pub fn root() -> PathBuf {
    match env::var_os(ROOT_VARIABLE) {
        Some(root) => PathBuf::from(root),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join(".."),
    }
}

/// A folder beside the build's own.
///
/// # Errors
/// When the system does not report where this binary is.
pub fn beside_the_build(name: &str) -> Result<PathBuf, Failure> {
    let release = own_folder()
        .map_err(|error| Failure::GivenUp(format!("cannot find the build's folder: {error}")))?;
    Ok(release.parent().unwrap_or(&release).join(name))
}

/// The Python of an environment.
pub fn python(home: &Path) -> PathBuf {
    home.join("bin").join("python")
}
