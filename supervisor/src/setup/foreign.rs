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

/// In words, the world that needs no setup.
pub const BUILT_IN: &str = "the built-in world";

/// A simulator that is installed into a Python environment of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Foreign {
    /// Its word in the configuration and in `./vlaps setup`, and the name of its folder
    /// beside the build's.
    pub simulator: Simulator,
    /// Its name in sentences.
    pub name: &'static str,
    /// What its environment takes on the disk.
    pub size: &'static str,
    /// The variable that names another folder of the Python environment.
    pub home_variable: &'static str,
    /// Where the world's Python files are in the repository: `world.py`, `requirements.txt`
    /// and `check.py`, which ends the setup.
    pub folder: &'static str,
    /// The Python that its packages exist for.
    pub python: Version,
    /// Where the simulator's own files come from.
    pub origin: Origin,
    /// Whether its world joins a run by libvlaps, which the setup then builds.
    pub is_on_library: bool,
    /// What drives there at once, as arguments of `up` after `--world`.
    pub first_drive: &'static str,
}

/// The Python of an environment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Version {
    /// This one alone.
    Exactly(u32, u32),
    /// This one or a later one.
    Least(u32, u32),
}

/// Where a simulator's own files come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// A package among its requirements.
    Package,
    /// A package among its requirements, or in place of it a checkout, which is copied.
    PackageOrCopy(Source),
    /// A checkout, which is read where it is.
    Checkout(Source),
}

/// The repository of a simulator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Source {
    /// Where git clones it from.
    pub address: &'static str,
    /// The folder of its package.
    pub package: &'static str,
    /// A file that a checkout of it has.
    pub landmark: &'static str,
    /// The name of its release in the requirements; empty without one.
    pub release: &'static str,
}

/// The real MetaDrive.
pub const METADRIVE: Foreign = Foreign {
    simulator: Simulator::MetaDrive,
    name: "MetaDrive",
    size: "1 GB",
    home_variable: "VLAPS_METADRIVE",
    folder: "sim/metadrive",
    // The only version that has packages of its graphics engine and can read TOML.
    python: Version::Exactly(3, 11),
    origin: Origin::PackageOrCopy(Source {
        address: "github.com/metadriverse/metadrive",
        package: "metadrive",
        // The environment of the experiment.
        landmark: "metadrive/envs/safe_metadrive_env.py",
        release: "metadrive-simulator",
    }),
    is_on_library: false,
    first_drive: "",
};

/// One row for each.
pub const FOREIGN: &[Foreign] = &[
    METADRIVE,
    Foreign {
        simulator: Simulator::IrSim,
        name: "ir-sim",
        size: "400 MB",
        home_variable: "VLAPS_IR_SIM",
        folder: "sim/irsim",
        python: Version::Least(3, 11),
        origin: Origin::Package,
        is_on_library: true,
        first_drive: " --vehicle vehicles/car-1-10.toml",
    },
    Foreign {
        simulator: Simulator::F1tenth,
        name: "the F1TENTH gym",
        size: "400 MB",
        home_variable: "VLAPS_F1TENTH",
        folder: "sim/f1tenth",
        python: Version::Least(3, 11),
        origin: Origin::Checkout(Source {
            address: "github.com/f1tenth/f1tenth_gym",
            package: "gym/f110_gym",
            landmark: "gym/f110_gym/envs/base_classes.py",
            release: "",
        }),
        is_on_library: true,
        first_drive: " --vehicle vehicles/car-1-10.toml --driver mpc",
    },
    Foreign {
        simulator: Simulator::CommonRoad,
        name: "CommonRoad",
        size: "400 MB",
        home_variable: "VLAPS_COMMONROAD",
        folder: "sim/commonroad",
        python: Version::Least(3, 11),
        // The scenarios; the packages are among the requirements.
        origin: Origin::Checkout(Source {
            address: "github.com/CommonRoad/commonroad-io",
            package: "commonroad",
            landmark: "commonroad/common/file_reader.py",
            release: "",
        }),
        is_on_library: true,
        first_drive: " --driver mpc --lockstep --episodes 8",
    },
];

impl Foreign {
    /// The one that a world needs; `None` for the built-in world.
    pub fn of(simulator: Simulator) -> Option<&'static Self> {
        FOREIGN.iter().find(|row| row.simulator == simulator)
    }

    /// A simulator in words.
    pub fn name_of(simulator: Simulator) -> &'static str {
        Self::of(simulator).map_or(BUILT_IN, |row| row.name)
    }

    /// Its word in `./vlaps setup`.
    pub fn part(&self) -> &'static str {
        self.simulator.word()
    }

    /// The folder of the world's Python files.
    ///
    /// # Errors
    /// When they are neither where this binary was built nor where `./vlaps` is.
    pub fn sources(&self) -> Result<PathBuf, Failure> {
        let sources = root()?.join(self.folder);
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
            None => beside_the_build(self.part()),
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
                self.part()
            )));
        }
        Ok(Program {
            process: Process::World,
            path,
            script: Some(self.sources()?.join("world.py")),
        })
    }
}

/// The folder of the repository: that of `./vlaps`, else the one above this binary.
///
/// # Errors
/// When the binary is in no repository, as that of a package.
pub fn root() -> Result<PathBuf, Failure> {
    if let Some(root) = env::var_os(ROOT_VARIABLE) {
        return Ok(root.into());
    }
    let own = own_folder().unwrap_or_default();
    let mut above = own.ancestors();
    let found = above.find(|folder| folder.join("supervisor/Cargo.toml").is_file());
    found.map(Path::to_path_buf).ok_or_else(|| {
        Failure::Usage(
            "this needs the repository, which the package does not hold: start it with ./vlaps of \
             a checkout"
                .into(),
        )
    })
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
