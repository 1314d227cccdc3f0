//! Files that are written at the end of something long: whether they can be is
//! said before it begins.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use shm_config::file::{Durable, check_writable, replace, user};

use crate::cli::failure::Failure;

/// Where an option's text goes.
#[derive(Debug)]
pub enum Output {
    /// A file, which is replaced as a whole.
    File(PathBuf),
    /// A device or a pipe, open since it was named: a pipe's reader would take a
    /// second opening for the end of what is written.
    Open(File),
}

impl Output {
    /// Of an option whose text is written later.
    ///
    /// # Errors
    /// What is in the way, and what to do; a pipe must have its reader by now.
    pub fn of_option(option: &str, path: &Path) -> Result<Self, Failure> {
        let opened = Self::open(path).map_err(|error| {
            let path = path.display();
            Failure::Usage(format!("{option} {path}: cannot write there: {error}"))
        })?;
        if let Self::File(_) = opened {
            check_file(option, path)?;
        }
        Ok(opened)
    }

    /// A link is followed if it is this user's or the system's.
    ///
    /// # Errors
    /// When another user has put a link there, or nothing reads the pipe.
    pub fn open(path: &Path) -> io::Result<Self> {
        check_link(path)?;
        let Ok(metadata) = path.metadata() else {
            return Ok(Self::File(path.into()));
        };
        if metadata.is_file() || metadata.is_dir() {
            return Ok(Self::File(path.canonicalize()?));
        }
        // Not to wait for a reader that may never come.
        let flags = OFlags::WRONLY | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
        let file = match rustix::fs::open(path, flags, Mode::empty()) {
            Err(Errno::NXIO) if metadata.file_type().is_fifo() => {
                return Err(refuse("nothing reads the pipe; start its reader first"));
            }
            Err(Errno::NXIO) => return Err(refuse("it can be no file's place; name a file")),
            opened => opened?,
        };
        // A reader may be slower than the text is long.
        fcntl_setfl(&file, fcntl_getfl(&file)? - OFlags::NONBLOCK)?;
        Ok(Self::Open(file.into()))
    }

    /// Writes the text: a file is there as it was, or whole and new.
    ///
    /// # Errors
    /// When the folder refuses, or the pipe's reader has gone.
    pub fn write(self, text: &str) -> io::Result<()> {
        match self {
            Self::File(path) => replace(&path, text.as_bytes(), Durable::Yes),
            Self::Open(mut file) => file.write_all(text.as_bytes()),
        }
    }
}

/// Writes a file beside its place, then moves it there. A link is followed, and
/// what is no plain file (a device, a pipe) is written to, never replaced.
///
/// # Errors
/// When the folder is missing or refuses, or nothing reads the pipe.
pub fn write_whole(path: &Path, text: &str) -> io::Result<()> {
    Output::open(path)?.write(text)
}

/// In a folder such as `/tmp` another user's link would select_run which of this user's
/// files is written over.
fn check_link(path: &Path) -> io::Result<()> {
    let Ok(metadata) = fs::symlink_metadata(path) else {
        return Ok(());
    };
    let owner = metadata.uid();
    let is_foreign = owner != 0 && owner != user();
    match metadata.is_symlink() && is_foreign {
        true => Err(refuse(&format!("it is a link of user {owner}"))),
        false => Ok(()),
    }
}

fn refuse(why: &str) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, why)
}

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
        let flags = OFlags::WRONLY | OFlags::APPEND | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let opened = path
            .is_file()
            .then(|| rustix::fs::open(path, flags, Mode::empty()));
        return match opened {
            None | Some(Ok(_)) => Ok(()),
            Some(Err(error)) => {
                let error = io::Error::from(error);
                Err(refused(option, path, &error.to_string()))
            }
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
    check_writable(folder).map_err(|error| {
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
