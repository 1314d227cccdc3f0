//! The folder in which a run keeps its configuration, logs and summary.

use std::io;
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use shm_config::config::Config;
use shm_config::file::{self, Durable, Entry, Folder};
use shm_config::run::Origin;

use crate::cli::failure::Failure;
use crate::run::place::Place;

/// Writes a file in the run's folder: the whole file or nothing.
///
/// # Errors
/// When its text cannot be produced, or the folder refuses it.
pub fn keep(folder: &Folder, name: &str, text: io::Result<String>) -> Result<(), Failure> {
    text.and_then(|text| folder.replace(name, text.as_bytes(), Durable::Yes))
        .map_err(|error| cannot_write(&folder.path().join(name), &error))
}

/// The error of a result file of the run that cannot be written.
pub fn cannot_write(path: &Path, error: &io::Error) -> Failure {
    Failure::GivenUp(format!(
        "{}: cannot write the results of the run: {error}",
        path.display()
    ))
}

/// Creates the run's folder with its resolved configuration, and locks it against other
/// runs as long as the returned folder is open. A copy of the configuration for the
/// processes and for observing commands lies beside the run's messages.
///
/// # Errors
/// When another user may change the folder, another run has locked it, or it cannot be
/// written.
pub fn prepare_folder(
    config: &Config,
    place: &Place,
    parent: Option<u32>,
) -> Result<Folder, Failure> {
    let failed = |what: &Path, error: &dyn std::fmt::Display| {
        Failure::Usage(format!(
            "{}: cannot keep the run's files: {error}; choose another folder with \
             `--set run.folder=DIR`",
            what.display()
        ))
    };
    // Without a trailing slash, which would follow a link.
    let path: PathBuf = Path::new(&config.run.folder).components().collect();
    let io_failed = |error: io::Error| failed(&path, &error);
    if let Some(above) = path.parent() {
        file::make_folders(above).map_err(|error| failed(above, &error))?;
    }
    drop(Folder::make(&path, Entry::Readable).map_err(io_failed)?);
    let path = path.canonicalize().map_err(io_failed)?;
    file::check_parents(&path).map_err(io_failed)?;
    let folder = Folder::open(&path, Entry::Readable).map_err(io_failed)?;
    let logs = folder.make_inside("logs", Entry::Readable);
    logs.map_err(|error| failed(&path.join("logs"), &error))?;
    match flock(&folder, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => {}
        Err(Errno::WOULDBLOCK) => {
            return Err(Failure::Usage(format!(
                "{}: another run keeps its files there; `./vlaps status` shows it; choose another \
                 folder with `--set run.folder=DIR`",
                path.display()
            )));
        }
        Err(error) => return Err(failed(&path, &error)),
    }
    let text = toml::to_string(config).map_err(|error| failed(&path, &error))?;
    let kept = folder.replace("config.toml", text.as_bytes(), Durable::Yes);
    kept.map_err(|error| failed(&path.join("config.toml"), &error))?;
    let copy = place.paths().config_file();
    file::replace(&copy, text.as_bytes(), Durable::No).map_err(|error| failed(&copy, &error))?;
    place.paths().keep_origin(&Origin {
        folder: path,
        parent,
    })?;
    Ok(folder)
}
