//! `setup`: installs what an optional part needs.

use std::path::PathBuf;
use std::sync::LazyLock;

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};

use crate::cli::failure::Failure;
use crate::setup::foreign::{FOREIGN, Foreign};
use crate::setup::{onnxruntime, package, ros, world};

/// Install what an optional part needs.
#[derive(Debug, Args)]
#[command(
    after_help = "Does only what is missing, so it may be repeated; with another --checkout, or \
        without, it replaces the MetaDrive that is there. A simulator is installed into target/PART; \
        environment variables such as VLAPS_METADRIVE and VLAPS_IR_SIM name other folders, for \
        setup, up, eval and bench alike.\n\n\
        Examples:\n  \
        ./vlaps setup metadrive\n  \
        ./vlaps setup ir-sim\n  \
        ./vlaps setup f1tenth --checkout ../f1tenth_gym\n  \
        ./vlaps setup commonroad --checkout ../commonroad-io\n  \
        ./vlaps setup onnxruntime\n  \
        ./vlaps setup ros\n  \
        ./vlaps setup link\n  \
        ./vlaps setup python && target/python/bin/python -c 'import vlaps'\n  \
        VLAPS_METADRIVE=$HOME/md-c29 ./vlaps setup metadrive --checkout ../metadrive"
)]
pub struct Setup {
    /// Which part.
    pub part: Part,
    /// The checkout of a simulator's repository; of f1tenth and commonroad always, of
    /// metadrive in place of its release. It is only read.
    ///
    /// The F1TENTH gym and CommonRoad's scenarios are in no package registry, so their files
    /// are read in the checkout, which has to stay where it is. MetaDrive's are copied: the
    /// built-in world mirrors commit c29cc37 of metadriverse/metadrive, and the release on the
    /// registry, 0.4.3, has older lanes at in- and out-ramps, so figures that are compared need
    /// the commit. All other packages stay as pinned.
    #[arg(long, value_name = "DIR")]
    pub checkout: Option<PathBuf>,
    /// The Python to install for; without it, python3 or python3.11.
    #[arg(long, value_name = "FILE")]
    pub python: Option<PathBuf>,
}

/// A part that needs more than a build.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// A simulator as world.
    World(&'static Foreign),
    /// ONNX Runtime.
    Onnxruntime,
    /// The programs for ROS 2.
    Ros,
    /// The programs for other machines.
    Link,
    /// The Python package vlaps.
    Python,
}

static PARTS: LazyLock<Vec<Part>> = LazyLock::new(|| {
    let worlds = FOREIGN.iter().map(Part::World);
    worlds
        .chain([Part::Onnxruntime, Part::Ros, Part::Link, Part::Python])
        .collect()
});

impl ValueEnum for Part {
    fn value_variants<'a>() -> &'a [Self] {
        &PARTS
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(match self {
            Self::World(row) => PossibleValue::new(row.part()).help(format!(
                "{} as world: a Python environment of about {}",
                row.name, row.size
            )),
            Self::Onnxruntime => PossibleValue::new("onnxruntime")
                .help("ONNX Runtime, for policies that are no chain of layers: 60 MB"),
            Self::Ros => PossibleValue::new("ros")
                .help("The programs for ROS 2 over Zenoh: 180 packages more, some minutes of compiling"),
            Self::Link => PossibleValue::new("link").help(
                "The programs for other machines over Zenoh: 190 packages more, some minutes of compiling",
            ),
            Self::Python => PossibleValue::new("python")
                .help("The Python package vlaps, built and installed into target/python: 150 MB"),
        })
    }
}

/// Makes what a part needs, as far as it is missing.
///
/// # Errors
/// One line that says which step failed, why, and what to do.
pub fn setup(arguments: &Setup) -> Result<(), Failure> {
    let python = arguments.python.as_deref();
    match arguments.part {
        Part::World(row) => world::setup(row, python, arguments.checkout.as_deref()),
        Part::Onnxruntime => onnxruntime::setup(python),
        Part::Ros => ros::setup(),
        Part::Link => ros::setup_link(),
        Part::Python => package::setup(python),
    }
}
