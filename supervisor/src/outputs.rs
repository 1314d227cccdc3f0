//! Files that are written at the end of something long: whether they can be is
//! said before it begins.

use std::fs::{self, OpenOptions};
use std::path::Path;

use crate::failure::Failure;

/// A file of an option can be written: it is there and lets itself be written, or
/// its folder does.
///
/// # Errors
/// What is in the way, and what to do.
pub fn check_file(option: &str, path: &Path) -> Result<(), Failure> {
    if path.is_dir() {
        return Err(refused(option, path, "is a folder"));
    }
    // What is no plain file (a device, a pipe) may wait for a reader: it is left
    // until there is something to write.
    if path.exists() {
        let opened = path
            .is_file()
            .then(|| OpenOptions::new().append(true).open(path));
        return match opened {
            None | Some(Ok(_)) => Ok(()),
            Some(Err(error)) => Err(refused(option, path, &error.to_string())),
        };
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    check_existing_folder((option, path), folder)
}

/// A folder of an option can be made, or is there, and files can be made in it.
///
/// # Errors
/// What is in the way, and what to do.
pub fn check_folder(option: &str, path: &Path) -> Result<(), Failure> {
    let here = Path::new(".");
    let existing = path
        .ancestors()
        .map(|folder| match folder.as_os_str().is_empty() {
            true => here,
            false => folder,
        })
        .find(|folder| folder.symlink_metadata().is_ok());
    check_existing_folder((option, path), existing.unwrap_or(here))
}

fn check_existing_folder((option, path): (&str, &Path), folder: &Path) -> Result<(), Failure> {
    if !folder.is_dir() {
        let why = format!("{} is no folder", folder.display());
        return Err(refused(option, path, &why));
    }
    // By trying: of root and of file systems that are read only, permissions say
    // nothing.
    let probe = folder.join(format!(".vlaps-{}", std::process::id()));
    OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(true)
        .open(&probe)
        .and_then(|_| fs::remove_file(&probe))
        .map_err(|error| {
            let why = format!("no file can be made in {}: {error}", folder.display());
            refused(option, path, &why)
        })
}

fn refused(option: &str, path: &Path, why: &str) -> Failure {
    Failure::Usage(format!(
        "{option} {}: cannot write there: {why}; name a place in an existing folder",
        path.display()
    ))
}
