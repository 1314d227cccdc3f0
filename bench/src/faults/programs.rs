//! The programs that a campaign tests in place of those of the build.

use std::path::{Path, PathBuf};

use clap::Args;
use supervisor::cli::print::quoted;
use supervisor::commands::up::arguments::{UpWorld, WorldOrProgram};

/// The options that name them, as those of `up`.
#[derive(Debug, Clone, Default, Args)]
pub struct Programs {
    /// The world of all sets: a simulator, as of `up`, or a program of yours, as a path with a '/'.
    #[arg(long, value_name = "WHICH|PROGRAM", value_parser = WorldOrProgram)]
    world: Option<UpWorld>,
    /// A program of yours that plans in all sets, in place of the planner of the build.
    #[arg(long, value_name = "PROGRAM")]
    planner: Option<PathBuf>,
}

impl Programs {
    /// The options as words. Paths are absolute, because a set runs in a folder of its own.
    pub fn words(&self) -> Vec<String> {
        let world = self.world.as_ref().map(|world| match world {
            UpWorld::Simulator(choice) => choice.word().into(),
            UpWorld::Program(path) => absolute(path),
        });
        let planner = self.planner.as_deref().map(absolute);
        [("--world", world), ("--planner", planner)]
            .into_iter()
            .filter_map(|(option, value)| Some([option.into(), value?]))
            .flatten()
            .collect()
    }

    /// The options as one line for a shell.
    pub fn line(&self) -> String {
        self.words()
            .iter()
            .map(|word| quoted(word))
            .collect::<Vec<_>>()
            .join(" ")
    }
}

/// An empty path stays as it is; `up` refuses it by its name.
fn absolute(path: &Path) -> String {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.into());
    whole.display().to_string()
}
