//! The programs of the build.

use std::fs::File;
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::cli::failure::Failure;

/// The folder of the supervisor's own executable, where its siblings are.
///
/// # Errors
/// When the system does not report it.
pub fn own_folder() -> io::Result<PathBuf> {
    let executable = std::env::current_exe()?;
    match executable.parent() {
        Some(folder) => Ok(folder.into()),
        None => Ok(Path::new("/").into()),
    }
}

/// Folder of the children's binaries, for tests of the supervisor alone.
const BINARIES_VARIABLE: &str = "VLAPS_BIN_DIR";

/// The folder of the binaries of the processes of a run.
///
/// # Errors
/// When the system does not report where this binary is.
pub fn binaries() -> Result<PathBuf, Failure> {
    match std::env::var_os(BINARIES_VARIABLE) {
        Some(folder) => Ok(folder.into()),
        None => own_folder()
            .map_err(|error| Failure::GivenUp(format!("cannot find the binaries: {error}"))),
    }
}

/// The file of a program.
#[derive(Debug)]
pub struct Executable {
    path: PathBuf,
    held: Option<File>,
}

impl Executable {
    /// The file that is at a path when it is started.
    pub fn at(path: PathBuf) -> Self {
        Self { path, held: None }
    }

    /// The file that is there now: a process is restarted by the program that the run began
    /// with, also when an upgrade has put another one in its place.
    ///
    /// # Errors
    /// When it cannot be opened.
    pub fn hold(path: PathBuf) -> io::Result<Self> {
        let held = Some(File::open(&path)?);
        Ok(Self { path, held })
    }

    /// The path that starts it: its own as long as the held file is there, because a process
    /// is named for the path that it was started by, else that of the held file.
    pub fn path(&self) -> PathBuf {
        let is_there = |held: &File| -> io::Result<bool> {
            let (held, there) = (held.metadata()?, std::fs::metadata(&self.path)?);
            Ok((held.dev(), held.ino()) == (there.dev(), there.ino()))
        };
        match &self.held {
            Some(held) if !is_there(held).unwrap_or(false) => {
                let (own, held) = (std::process::id(), held.as_raw_fd());
                format!("/proc/{own}/fd/{held}").into()
            }
            _ => self.path.clone(),
        }
    }
}
