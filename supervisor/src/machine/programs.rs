//! The programs of the build.

use std::io;
use std::path::{Path, PathBuf};

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
