//! Commands that another program of the build carries out.

use std::os::unix::process::CommandExt;
use std::process::Command;

use shm_config::secret;

use crate::arguments::HandedOver;
use crate::cli::failure::Failure;
use crate::set::launch::own_folder;

/// The program of `eval`, `bench`, `draw` and `train`. The supervisor does not
/// link it: it brings the built-in world and all drivers along.
pub const BENCH: &str = "vlaps-bench";
/// The program of `judge` and `judge-server`, with an HTTP client and a server.
pub const JUDGE: &str = "vlaps-judge";

/// Becomes another program of the build; only returns when it cannot.
///
/// # Errors
/// When that program is not beside this one.
pub fn hand_over(name: &str, command: &[&str], rest: &HandedOver) -> Result<(), Failure> {
    let folder = own_folder()
        .map_err(|error| Failure::GivenUp(format!("cannot find the build's folder: {error}")))?;
    let program = folder.join(name);
    let mut become_it = Command::new(&program);
    // It may ask a judge itself, or start a supervisor whose gate does.
    secret::hand_on(&mut become_it);
    let error = become_it.args(command).args(&rest.words).exec();
    Err(Failure::GivenUp(format!(
        "{}: {error}; build it with cargo build --release --workspace --bins",
        program.display()
    )))
}
