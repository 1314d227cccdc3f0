//! The files of a run's shared memory.
//!
//! Every user may create files in that folder, under any name. A file of another user,
//! or something that is not a file, is never part of a run: it is neither changed nor
//! removed, and it blocks nothing.

use std::fmt;
use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, CWD, Dir, FileType, Mode, OFlags, Stat};
use rustix::io::Errno;

use super::{RunError, RunPaths, SHARED_MEMORY_DIR};
use crate::file::user;

/// Permission bits of other users.
const OTHERS: u32 = 0o077;

/// A name like those of a run's shared memory that does not belong to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stranger {
    /// Where it is.
    pub path: PathBuf,
    /// Its owner's user id.
    pub owner: u32,
}

impl fmt::Display for Stranger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, owner } = self;
        let path = path.display();
        match *owner == user() {
            true => write!(f, "{path}: is no shared memory; it is left alone"),
            false => write!(f, "{path}: belongs to user {owner}; it is left alone"),
        }
    }
}

/// The run's entries in the folder of shared memory.
pub(super) struct Shared {
    folder: OwnedFd,
    /// The names and files or sockets of the calling user.
    ours: Vec<(String, Stat)>,
    strangers: Vec<Stranger>,
}

impl Shared {
    /// Reads every name that begins with the prefix.
    pub(super) fn look(prefix: &str) -> Result<Self, RunError> {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
        let opened = rustix::fs::openat(CWD, SHARED_MEMORY_DIR, flags, Mode::empty());
        let folder = opened.map_err(failed(SHARED_MEMORY_DIR))?;
        let mut shared = Self {
            ours: Vec::new(),
            strangers: Vec::new(),
            folder,
        };
        let entries = Dir::read_from(&shared.folder).map_err(failed(SHARED_MEMORY_DIR))?;
        for entry in entries.flatten() {
            // The library's own names are plain letters.
            let name = entry.file_name().to_string_lossy().into_owned();
            if !name.starts_with(prefix) {
                continue;
            }
            let stat =
                rustix::fs::statat(&shared.folder, entry.file_name(), AtFlags::SYMLINK_NOFOLLOW);
            // It may have been removed in between.
            let Ok(stat) = stat else { continue };
            let kind = FileType::from_raw_mode(stat.st_mode);
            let is_file = matches!(kind, FileType::RegularFile | FileType::Socket);
            match is_file && stat.st_uid == user() {
                true => shared.ours.push((name, stat)),
                false => shared.strangers.push(Stranger {
                    path: Path::new(SHARED_MEMORY_DIR).join(name),
                    owner: stat.st_uid,
                }),
            }
        }
        Ok(shared)
    }

    fn path(name: &str) -> PathBuf {
        Path::new(SHARED_MEMORY_DIR).join(name)
    }

    /// Removes the user's own files; returns bytes and number of files.
    pub(super) fn remove(&self) -> Result<(u64, usize), RunError> {
        let (mut bytes, mut files) = (0, 0);
        for (name, stat) in &self.ours {
            match rustix::fs::unlinkat(&self.folder, name, AtFlags::empty()) {
                Ok(()) => {}
                Err(Errno::NOENT) => continue,
                Err(error) => return Err(failed(Self::path(name))(error)),
            }
            bytes += u64::try_from(stat.st_blocks).unwrap_or_default() * 512;
            files += 1;
        }
        Ok((bytes, files))
    }

    /// Removes the rights of other users to the user's own files.
    fn close_to_others(&self) -> Result<(), RunError> {
        for (name, stat) in &self.ours {
            let is_file = FileType::from_raw_mode(stat.st_mode) == FileType::RegularFile;
            if is_file && stat.st_mode & OTHERS != 0 {
                match self.close_file(name) {
                    Ok(()) | Err(Errno::NOENT) => {}
                    Err(error) => return Err(failed(Self::path(name))(error)),
                }
            }
        }
        Ok(())
    }

    /// Opens the file and examines it again, because the name may lead to another file
    /// by now.
    fn close_file(&self, name: &str) -> Result<(), Errno> {
        let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
        let open = |access| rustix::fs::openat(&self.folder, name, access | flags, Mode::empty());
        let file = match open(OFlags::RDONLY) {
            // The library writes some files before other processes may read them.
            Err(Errno::ACCESS) => open(OFlags::WRONLY)?,
            opened => opened?,
        };
        let stat = rustix::fs::fstat(&file)?;
        let is_file = FileType::from_raw_mode(stat.st_mode) == FileType::RegularFile;
        match is_file && stat.st_uid == user() {
            // The owner's bits are kept, because the library encodes the file's state
            // in them.
            true => rustix::fs::fchmod(&file, Mode::from_raw_mode(stat.st_mode & 0o700)),
            false => Ok(()),
        }
    }
}

impl RunPaths {
    /// The run's shared-memory files that exist now.
    ///
    /// # Errors
    /// When the folder of shared memory cannot be read.
    pub fn shared_memory(&self) -> Result<Vec<PathBuf>, RunError> {
        let shared = Shared::look(&self.prefix())?;
        let names = shared.ours.iter();
        Ok(names.map(|(name, _)| Shared::path(name)).collect())
    }

    /// Entries that are named like the run's shared memory but do not belong to it.
    ///
    /// # Errors
    /// When the folder of shared memory cannot be read.
    pub fn strangers(&self) -> Result<Vec<Stranger>, RunError> {
        Ok(Shared::look(&self.prefix())?.strangers)
    }

    /// Closes shared memory that the library leaves open to every user (a counter
    /// of nodes, 16 bytes) to all but this one.
    pub(crate) fn make_private(&self) -> Result<(), RunError> {
        Shared::look(&self.prefix())?.close_to_others()
    }
}

fn failed(path: impl Into<PathBuf>) -> impl FnOnce(Errno) -> RunError {
    let path = path.into();
    move |error| RunError::Io {
        path,
        source: io::Error::from(error),
    }
}
