//! Files and folders: opened once, checked, then used by their descriptor.
//!
//! There are two kinds. A file that a command line or a configuration names may be a
//! link and may belong to another user; it is read if it is a regular file of a bounded
//! size. A file or folder *of ours* is one that a run keeps for itself: it belongs to
//! the calling user, only this user may write to it, and no link to it is followed,
//! because another user could have put a link or a pipe in its place.

mod folder;

pub use folder::Folder;

use std::fs::{DirBuilder, File, Metadata};
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, CWD, FileType, Mode, OFlags, Stat};
use rustix::io::Errno;

/// Names that are tried for a new file that replaces another one. A name is taken only
/// if an earlier process with this id was killed.
const NEW_NAMES: u32 = 16;

/// Permission bits by which other users may change a file or folder.
const OTHERS_WRITE: u32 = 0o022;
/// Permission bits by which other users may do anything with it.
const OTHERS_ANY: u32 = 0o077;

/// Flags of every open here: a pipe does not wait for its other end, a terminal does
/// not become the controlling one, no child inherits the descriptor.
const CAREFUL: OFlags = OFlags::CLOEXEC
    .union(OFlags::NONBLOCK)
    .union(OFlags::NOCTTY);

/// The file or folder is not the calling user's alone.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NotOurs {
    /// It belongs to another user.
    #[error("belongs to user {owner} (mode {mode:o}), not to user {user}", user = user())]
    Owner {
        /// Its owner's user id.
        owner: u32,
        /// Its permission bits.
        mode: u32,
    },
    /// Its permissions admit other users.
    #[error(
        "is open to other users (owner {owner}, mode {mode:o}); `chmod go-{letters}` closes it",
        letters = if mode & OTHERS_WRITE != 0 { "w" } else { "rwx" }
    )]
    Open {
        /// Its owner's user id.
        owner: u32,
        /// Its permission bits.
        mode: u32,
    },
}

impl From<NotOurs> for io::Error {
    fn from(error: NotOurs) -> Self {
        Self::new(io::ErrorKind::PermissionDenied, error)
    }
}

impl NotOurs {
    /// The reason in an error of this module; `None` in any other error.
    pub fn within(error: &io::Error) -> Option<&Self> {
        error.get_ref()?.downcast_ref()
    }

    /// Owner and permission bits.
    pub fn owner_and_mode(&self) -> (u32, u32) {
        match *self {
            Self::Owner { owner, mode } | Self::Open { owner, mode } => (owner, mode),
        }
    }
}

/// The access with which a file of ours is opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Access {
    /// To read it.
    Read,
    /// To read it and to append; it is created if it is missing.
    Append,
    /// To read it and to write anywhere; it is created if it is missing.
    Change,
    /// To read it and to append; no file of that name may exist.
    New,
}

/// Whether a written file survives a power cut.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Durable {
    /// The content is on the disk before the file has its name.
    Yes,
    /// The kernel writes it later.
    No,
}

/// Which users a folder of ours admits, and the files created in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry {
    /// The calling user alone.
    Private,
    /// Other users may read it and change nothing.
    Readable,
}

/// The calling user's id.
pub fn user() -> u32 {
    rustix::process::getuid().as_raw()
}

/// The metadata of a file that is about to be read. Read before it is opened: opening a
/// pipe would wait, and a device has no end.
///
/// # Errors
/// When there is nothing at the path, or no regular file.
pub fn regular(path: &Path) -> io::Result<Metadata> {
    check_regular(path.metadata()?)
}

/// Reads a regular file of at most `bytes_max` bytes, of any owner; links are followed.
/// A pipe is refused at once.
///
/// # Errors
/// When there is no such file, it is not a regular file, or it is longer.
pub fn read(path: &Path, bytes_max: u64) -> io::Result<Vec<u8>> {
    read_bounded(&open_regular(path)?, bytes_max)
}

/// As [`read`], for a text.
///
/// # Errors
/// As [`read`], and when it is not UTF-8.
pub fn read_text(path: &Path, bytes_max: u64) -> io::Result<String> {
    text(read(path, bytes_max)?)
}

/// Opens a regular file that the calling user alone may read or change, to read a key of
/// it; links are followed. What is checked is the opened file, so that no other one can take
/// its place afterwards.
///
/// # Errors
/// When there is no such file or it is not a regular one; [`NotOurs`] when it belongs to
/// another user or others have any right to it.
pub fn open_private(path: &Path) -> io::Result<File> {
    let file = open_regular(path)?;
    check_ours(&rustix::fs::fstat(&file)?, OTHERS_ANY)?;
    Ok(file)
}

/// Reads the text of a file as [`open_private`] opens it, of at most `bytes_max` bytes.
///
/// # Errors
/// As [`open_private`], and when it is longer or not UTF-8.
pub fn read_private(path: &Path, bytes_max: u64) -> io::Result<String> {
    text(read_bounded(&open_private(path)?, bytes_max)?)
}

/// Opens a file of ours by its path: see [`Folder::open_file`].
///
/// # Errors
/// As [`Folder::open_file`].
pub fn open_ours(path: &Path, access: Access) -> io::Result<File> {
    open_at(CWD, path, access, Entry::Readable)
}

/// Reads a file of ours of at most `bytes_max` bytes by its path.
///
/// # Errors
/// As [`Folder::read`].
pub fn read_ours(path: &Path, bytes_max: u64) -> io::Result<Vec<u8>> {
    read_bounded(&open_ours(path, Access::Read)?, bytes_max)
}

/// Writes a file so that its name refers to either the old or the whole new content.
/// The new file is created under a free name; an entry at `path`, also a link, is
/// replaced and not followed.
///
/// # Errors
/// When the folder is missing or refuses; the old content stays.
pub fn replace(path: &Path, bytes: &[u8], durable: Durable) -> io::Result<()> {
    replace_with(path, durable, |file| file.write_all(bytes))
}

/// As [`replace`], with content that is written piece by piece.
///
/// # Errors
/// As [`replace`], and what `write` returns.
pub fn replace_with(
    path: &Path,
    durable: Durable,
    write: impl FnOnce(&mut File) -> io::Result<()>,
) -> io::Result<()> {
    let name = path.file_name().ok_or(Errno::ISDIR)?;
    let parent = path
        .parent()
        .filter(|parent| !parent.as_os_str().is_empty());
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | CAREFUL;
    let folder = rustix::fs::open(parent.unwrap_or(Path::new(".")), flags, Mode::empty())?;
    let folder = (folder.as_fd(), Entry::Readable);
    replace_at(folder, Path::new(name), durable, write)
}

/// Whether the name is a temporary one of [`replace`], left by a killed process.
pub fn is_unfinished(name: &str) -> bool {
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
    let mut parts = name.rsplitn(2, '.');
    let suffix = parts.next().and_then(|suffix| suffix.split_once('-'));
    suffix.is_some_and(|(pid, number)| is_number(pid) && is_number(number))
        && parts.next().is_some_and(|replaced| !replaced.is_empty())
}

/// Creates a folder and its parents where they are missing, so that only this user may
/// write to them; by default many systems let the user's group write.
///
/// # Errors
/// When one cannot be made.
pub fn make_folders(path: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o755).create(path)
}

/// Checks that files can be created in this folder: creates one and removes it.
/// Permissions are not sufficient, for root and for read-only file systems.
///
/// # Errors
/// When the folder is missing or refuses.
pub fn check_writable(folder: &Path) -> io::Result<()> {
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | CAREFUL;
    let folder = rustix::fs::open(folder, flags, Mode::empty())?;
    let probe = (folder.as_fd(), Entry::Private);
    let (name, _file) = make_beside(probe, Path::new(".vlaps"))?;
    Ok(rustix::fs::unlinkat(&folder, &name, AtFlags::empty())?)
}

/// Checks that only this user and root can replace this folder by another: each folder
/// above it is closed to others, or lets each user rename their own files only, as
/// `/tmp` does. Groups are not checked: on many systems a user's own group may write by
/// default.
///
/// # Errors
/// Names the folder in which every user may rename the entries.
pub fn check_parents(path: &Path) -> io::Result<()> {
    for folder in path.ancestors().skip(1) {
        let stat = rustix::fs::stat(folder)?;
        let is_open = stat.st_mode & 0o002 != 0 && stat.st_mode & 0o1000 == 0;
        if is_open {
            let what = format!(
                "every user may rename what is in {} (mode {:o}), this folder too",
                folder.display(),
                stat.st_mode & 0o7777
            );
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, what));
        }
    }
    Ok(())
}

/// Checks that it belongs to the calling user and has none of the `others` bits.
///
/// # Errors
/// [`NotOurs`].
pub fn check_ours(stat: &Stat, others: u32) -> Result<(), NotOurs> {
    let (owner, mode) = (stat.st_uid, stat.st_mode & 0o7777);
    if owner != user() {
        return Err(NotOurs::Owner { owner, mode });
    }
    match mode & others {
        0 => Ok(()),
        _ => Err(NotOurs::Open { owner, mode }),
    }
}

fn make_at(at: BorrowedFd, name: &Path, entry: Entry) -> io::Result<()> {
    let others = match entry {
        Entry::Private => Mode::empty(),
        Entry::Readable => Mode::from_raw_mode(0o055),
    };
    match rustix::fs::mkdirat(at, name, Mode::RWXU | others) {
        Ok(()) | Err(Errno::EXIST) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

fn open_at(at: BorrowedFd, name: &Path, access: Access, entry: Entry) -> io::Result<File> {
    let flags = match access {
        Access::Read => OFlags::RDONLY,
        Access::Append => OFlags::RDWR | OFlags::APPEND | OFlags::CREATE,
        Access::Change => OFlags::RDWR | OFlags::CREATE,
        Access::New => OFlags::RDWR | OFlags::APPEND | OFlags::CREATE | OFlags::EXCL,
    };
    let others = match entry {
        Entry::Private => Mode::empty(),
        Entry::Readable => Mode::RGRP | Mode::ROTH,
    };
    let flags = flags | OFlags::NOFOLLOW | CAREFUL;
    let fd = rustix::fs::openat(at, name, flags, Mode::RUSR | Mode::WUSR | others)
        .map_err(|error| name_link(at, name, error))?;
    let stat = rustix::fs::fstat(&fd)?;
    check_ours(&stat, 0)?;
    if FileType::from_raw_mode(stat.st_mode) != FileType::RegularFile {
        return Err(not_regular());
    }
    Ok(fd.into())
}

fn replace_at(
    (at, entry): (BorrowedFd, Entry),
    name: &Path,
    durable: Durable,
    write: impl FnOnce(&mut File) -> io::Result<()>,
) -> io::Result<()> {
    let (beside, mut file) = make_beside((at, entry), name)?;
    let written = write(&mut file).and_then(|()| match durable {
        Durable::Yes => file.sync_all(),
        Durable::No => Ok(()),
    });
    let moved = written.and_then(|()| Ok(rustix::fs::renameat(at, &beside, at, name)?));
    if moved.is_err() {
        // An incomplete file is removed.
        let _ = rustix::fs::unlinkat(at, &beside, AtFlags::empty());
        return moved;
    }
    if durable == Durable::Yes {
        // Some file systems do not support this; the rename is then as safe as they are.
        let _ = rustix::fs::fsync(at);
    }
    Ok(())
}

/// A new file beside the one of this name, and its own name.
fn make_beside((at, entry): (BorrowedFd, Entry), name: &Path) -> io::Result<(PathBuf, File)> {
    let mut taken = Errno::EXIST.into();
    for number in 0..NEW_NAMES {
        let mut beside = name.as_os_str().to_owned();
        beside.push(format!(".{}-{number}", std::process::id()));
        let beside = PathBuf::from(beside);
        match open_at(at, &beside, Access::New, entry) {
            Ok(file) => return Ok((beside, file)),
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => taken = error,
            Err(error) => return Err(error),
        }
    }
    Err(taken)
}

fn open_regular(path: &Path) -> io::Result<File> {
    let flags = OFlags::RDONLY | CAREFUL;
    let file = File::from(rustix::fs::open(path, flags, Mode::empty())?);
    check_regular(file.metadata()?)?;
    Ok(file)
}

fn read_bounded(file: &File, bytes_max: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(bytes_max.saturating_add(1))
        .read_to_end(&mut bytes)?;
    match bytes.len() as u64 > bytes_max {
        true => Err(io::Error::new(
            io::ErrorKind::FileTooLarge,
            format!("is longer than the {bytes_max} bytes that are read of it"),
        )),
        false => Ok(bytes),
    }
}

fn text(bytes: Vec<u8>) -> io::Result<String> {
    let wrong = |error| io::Error::new(io::ErrorKind::InvalidData, error);
    String::from_utf8(bytes).map_err(wrong)
}

fn check_regular(metadata: Metadata) -> io::Result<Metadata> {
    match metadata.is_file() {
        true => Ok(metadata),
        false => Err(not_regular()),
    }
}

fn not_regular() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, "is no regular file")
}

/// Replaces the system's error for a link that is not followed by a clear one.
fn name_link(at: BorrowedFd, name: &Path, error: Errno) -> io::Error {
    let is_link = || {
        rustix::fs::statat(at, name, AtFlags::SYMLINK_NOFOLLOW)
            .is_ok_and(|stat| FileType::from_raw_mode(stat.st_mode) == FileType::Symlink)
    };
    match error {
        Errno::LOOP | Errno::NOTDIR if is_link() => io::Error::new(
            io::ErrorKind::InvalidInput,
            "is a symbolic link, which is not followed here",
        ),
        // A pipe without a reader, and a socket.
        Errno::NXIO => not_regular(),
        error => error.into(),
    }
}
