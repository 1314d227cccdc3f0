//! Commands that another program of the build carries out.

use clap::Args;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::Command;

use shm_config::secret;

use crate::cli::failure::Failure;
use crate::machine::programs::own_folder;

/// The arguments of a command that another program of the build carries out.
#[derive(Debug, Args)]
pub struct Delegated {
    /// Its options; --help shows them.
    #[arg(
        trailing_var_arg = true,
        allow_hyphen_values = true,
        value_name = "OPTIONS"
    )]
    pub words: Vec<OsString>,
}

impl Delegated {
    /// The words of this process, which it has parsed itself.
    pub fn own() -> Self {
        let words = std::env::args_os().skip(1).collect();
        Self { words }
    }
}

/// The program of `eval`, `train`, `sweep`, `replay`, `fork`, `regress`, `export` and
/// `draw`. The supervisor does not link it: it holds the built-in world and all drivers.
pub const LAB: &str = "vlaps-lab";
/// The program of `bench`.
pub const BENCH: &str = "vlaps-bench";
/// The program of `record`.
pub const RECORDER: &str = "vlaps-recorder";
/// The program of `view`, with an HTTP server.
pub const VIEW: &str = "vlaps-view";
/// The program of `judge`, with an HTTP client and a server.
pub const JUDGE: &str = "vlaps-judge";

/// The program of `link` and `join`, of a workspace of its own.
pub const LINK: &str = "vlaps-link";

/// Executes another program of the build in place of this one; returns only on an
/// error.
///
/// # Errors
/// When that program is not beside this one.
pub fn delegate(name: &str, command: &[&str], rest: &Delegated) -> Result<(), Failure> {
    let folder = own_folder()
        .map_err(|error| Failure::GivenUp(format!("cannot find the build's folder: {error}")))?;
    let program = folder.join(name);
    let mut become_it = Command::new(&program);
    // That program may ask a judge itself, or start a supervisor whose gate does.
    secret::hand_on(&mut become_it);
    let error = become_it.args(command).args(&rest.words).exec();
    let build = match name {
        LINK => "./vlaps setup link",
        _ => "cargo build --release --workspace --bins",
    };
    let program = program.display();
    Err(Failure::GivenUp(format!(
        "{program}: {error}; build it with {build}"
    )))
}
