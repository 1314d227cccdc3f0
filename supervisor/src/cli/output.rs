//! Files that are written at the end of long work. They are checked before the work starts.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

use rustix::fs::{Mode, OFlags, fcntl_getfl, fcntl_setfl};
use rustix::io::Errno;
use shm_config::file::{Durable, check_writable, replace, user};

use crate::cli::failure::Failure;

/// Where the text of an option is written.
#[derive(Debug)]
pub enum Output {
    /// A file, which is replaced as a whole.
    File(PathBuf),
    /// A device or a pipe, kept open from the start: a pipe's reader would take closing and
    /// reopening for the end of the text.
    Open(File),
}

impl Output {
    /// The output of an option whose text is written later.
    ///
    /// # Errors
    /// Why it cannot be written, and what to do; a pipe must already have its reader.
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

    /// Opens an output. A link is followed if it belongs to this user or to root.
    ///
    /// # Errors
    /// When it is a link of another user, or the pipe has no reader.
    pub fn open(path: &Path) -> io::Result<Self> {
        check_link(path)?;
        let Ok(metadata) = path.metadata() else {
            return Ok(Self::File(path.into()));
        };
        if metadata.is_file() || metadata.is_dir() {
            return Ok(Self::File(path.canonicalize()?));
        }
        // Opening must not wait for a reader that may never come.
        let flags = OFlags::WRONLY | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
        let file = match rustix::fs::open(path, flags, Mode::empty()) {
            Err(Errno::NXIO) if metadata.file_type().is_fifo() => {
                return Err(refuse("nothing reads the pipe; start its reader first"));
            }
            Err(Errno::NXIO) => return Err(refuse("it is not a file; name a file")),
            opened => opened?,
        };
        // Writing blocks, since a reader may be slow.
        fcntl_setfl(&file, fcntl_getfl(&file)? - OFlags::NONBLOCK)?;
        Ok(Self::Open(file.into()))
    }

    /// Writes the text: a reader of the file finds the old content or the whole new one.
    ///
    /// # Errors
    /// When the folder refuses, or the pipe's reader has ended.
    pub fn write(self, text: &str) -> io::Result<()> {
        match self {
            Self::File(path) => replace(&path, text.as_bytes(), Durable::Yes),
            Self::Open(mut file) => file.write_all(text.as_bytes()),
        }
    }
}

/// Writes a temporary file and renames it to `path`. A link is followed; a device or a pipe
/// is written to and never replaced.
///
/// # Errors
/// When the folder is missing or refuses, or nothing reads the pipe.
pub fn write_whole(path: &Path, text: &str) -> io::Result<()> {
    Output::open(path)?.write(text)
}

/// In a folder such as `/tmp`, the link of another user would choose which of this
/// user's files is overwritten.
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

/// Checks that the file of an option can be written or created.
///
/// # Errors
/// Why it cannot be written, and what to do.
pub fn check_file(option: &str, path: &Path) -> Result<(), Failure> {
    if path.is_dir() {
        return Err(refused(option, path, "is a folder"));
    }
    // A device or a pipe may have no reader yet: it is opened when there is text to
    // write.
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

/// Checks that the folder of an option exists or can be created, and that files can be
/// created in it.
///
/// # Errors
/// Why it cannot be written, and what to do.
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
        let why = format!("{} is not a folder", folder.display());
        return Err(refused(option, path, &why));
    }
    check_writable(folder).map_err(|error| {
        let why = format!("no file can be created in {}: {error}", folder.display());
        refused(option, path, &why)
    })
}

fn refused(option: &str, path: &Path, why: &str) -> Failure {
    Failure::Usage(format!(
        "{option} {}: cannot write there: {why}; name a place in an existing folder",
        path.display()
    ))
}
