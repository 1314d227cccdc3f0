//! `setup`: installs what an optional part needs.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::cli::failure::Failure;
use crate::setup::{install, irsim, onnxruntime, package, ros};

/// Install what an optional part needs.
#[derive(Debug, Args)]
#[command(
    after_help = "Does only what is missing, so it may be repeated; with another --checkout, or \
        without, it replaces the MetaDrive that is there. It installs into target/metadrive and \
        target/ir-sim; the environment variables VLAPS_METADRIVE and VLAPS_IR_SIM name other \
        folders, for setup, up, eval and bench alike.\n\n\
        Examples:\n  \
        ./vlaps setup metadrive\n  \
        ./vlaps setup ir-sim\n  \
        ./vlaps setup onnxruntime\n  \
        ./vlaps setup ros\n  \
        ./vlaps setup python && target/python/bin/python -c 'import vlaps'\n  \
        VLAPS_METADRIVE=$HOME/md-c29 ./vlaps setup metadrive --checkout ../metadrive"
)]
pub struct Setup {
    /// Which part.
    pub part: Part,
    /// Install MetaDrive from this checkout of its repository, not its release.
    ///
    /// The built-in world mirrors commit c29cc37 of metadriverse/metadrive. The
    /// release on the registry, 0.4.3, has older lanes at in- and out-ramps:
    /// figures that are compared need the commit. The checkout is only read; all
    /// other packages stay as pinned.
    #[arg(long, value_name = "DIR")]
    pub checkout: Option<PathBuf>,
    /// The Python to install for; without it, python3.11 or python3.
    #[arg(long, value_name = "FILE")]
    pub python: Option<PathBuf>,
}

/// A part that needs more than a build.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// The real MetaDrive as world: a Python environment of about 1 GB.
    Metadrive,
    /// The simulator ir-sim as world: a Python environment of about 400 MB.
    IrSim,
    /// ONNX Runtime, for policies that are no chain of layers: 60 MB.
    Onnxruntime,
    /// The programs for ROS 2 over Zenoh: 230 packages, some minutes of compiling.
    Ros,
    /// The Python package vlaps, built and installed into target/python: 150 MB.
    Python,
}

/// Makes what a part needs, as far as it is missing.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup(arguments: &Setup) -> Result<(), Failure> {
    match arguments.part {
        Part::Metadrive => {
            install::install_metadrive(arguments.python.as_deref(), arguments.checkout.as_deref())
        }
        Part::IrSim => irsim::setup(arguments.python.as_deref()),
        Part::Onnxruntime => onnxruntime::setup(arguments.python.as_deref()),
        Part::Ros => ros::setup(),
        Part::Python => package::setup(arguments.python.as_deref()),
    }
}
