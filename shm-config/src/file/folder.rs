//! A folder of ours, held open.

use std::fs::File;
use std::io::{self, Write as _};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, CWD, Mode, OFlags, Stat};

use super::{
    Access, CAREFUL, Durable, Entry, OTHERS_ANY, OTHERS_WRITE, check_ours, make_at, name_link,
    open_at, read_bounded, replace_at, text,
};

/// A folder of ours, held open: all operations act on this folder, even when its path
/// leads to another one in the meantime.
#[derive(Debug)]
pub struct Folder {
    fd: OwnedFd,
    path: PathBuf,
    entry: Entry,
}

impl Folder {
    /// Opens a folder. The last part of its path is not followed if it is a link.
    ///
    /// # Errors
    /// When it is missing, a link or no folder; [`NotOurs`](super::NotOurs) when it belongs to
    /// another user or lets others in.
    pub fn open(path: &Path, entry: Entry) -> io::Result<Self> {
        // A slash or a dot at the end would follow the link.
        let path: PathBuf = path.components().collect();
        Self::open_at(CWD, &path, path.clone(), entry)
    }

    /// Opens a folder, which is created if it is missing; the folder above it must
    /// exist.
    ///
    /// # Errors
    /// As [`Folder::open`], and when it cannot be made.
    pub fn make(path: &Path, entry: Entry) -> io::Result<Self> {
        let path: PathBuf = path.components().collect();
        make_at(CWD, &path, entry)?;
        Self::open_at(CWD, &path, path.clone(), entry)
    }

    /// A folder within this one, made if it is missing.
    ///
    /// # Errors
    /// As [`Folder::make`].
    pub fn make_inside(&self, name: &str, entry: Entry) -> io::Result<Self> {
        make_at(self.fd.as_fd(), Path::new(name), entry)?;
        self.inside(name, entry)
    }

    /// A folder within this one.
    ///
    /// # Errors
    /// As [`Folder::open`].
    pub fn inside(&self, name: &str, entry: Entry) -> io::Result<Self> {
        let path = self.path.join(name);
        Self::open_at(self.fd.as_fd(), Path::new(name), path, entry)
    }

    fn open_at(at: BorrowedFd, name: &Path, path: PathBuf, entry: Entry) -> io::Result<Self> {
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | CAREFUL;
        let fd = rustix::fs::openat(at, name, flags, Mode::empty())
            .map_err(|error| name_link(at, name, error))?;
        let others = match entry {
            Entry::Private => OTHERS_ANY,
            Entry::Readable => OTHERS_WRITE,
        };
        check_ours(&rustix::fs::fstat(&fd)?, others)?;
        Ok(Self { fd, path, entry })
    }

    /// Where it was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens a regular file of ours in it, without following a link.
    ///
    /// # Errors
    /// When it is missing, a link, or no regular file; [`NotOurs`](super::NotOurs) when it belongs
    /// to another user.
    pub fn open_file(&self, name: &str, access: Access) -> io::Result<File> {
        open_at(self.fd.as_fd(), Path::new(name), access, self.entry)
    }

    /// Reads a file of ours of at most `bytes_max` bytes.
    ///
    /// # Errors
    /// As [`Folder::open_file`], and when it is longer.
    pub fn read(&self, name: &str, bytes_max: u64) -> io::Result<Vec<u8>> {
        read_bounded(&self.open_file(name, Access::Read)?, bytes_max)
    }

    /// The same of a text.
    ///
    /// # Errors
    /// As [`Folder::read`], and when it is no UTF-8.
    pub fn read_text(&self, name: &str, bytes_max: u64) -> io::Result<String> {
        text(self.read(name, bytes_max)?)
    }

    /// Writes a file as [`replace`](super::replace) does.
    ///
    /// # Errors
    /// When the folder refuses; the old content stays.
    pub fn replace(&self, name: &str, bytes: &[u8], durable: Durable) -> io::Result<()> {
        let folder = (self.fd.as_fd(), self.entry);
        replace_at(folder, Path::new(name), durable, |file| {
            file.write_all(bytes)
        })
    }

    /// Renames an entry; an entry with the new name is replaced.
    ///
    /// # Errors
    /// When there is nothing of that name, or the folder refuses.
    pub fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        Ok(rustix::fs::renameat(&self.fd, from, &self.fd, to)?)
    }

    /// Removes an entry that is not a folder; a link is removed, its target stays.
    ///
    /// # Errors
    /// When the folder refuses.
    pub fn remove(&self, name: &str) -> io::Result<()> {
        Ok(rustix::fs::unlinkat(&self.fd, name, AtFlags::empty())?)
    }

    /// The metadata of an entry; links are not followed.
    ///
    /// # Errors
    /// When there is nothing of that name.
    pub fn look(&self, name: &str) -> io::Result<Stat> {
        Ok(rustix::fs::statat(
            &self.fd,
            name,
            AtFlags::SYMLINK_NOFOLLOW,
        )?)
    }

    /// Creates a symbolic link in it.
    ///
    /// # Errors
    /// When the name is taken, or the folder refuses.
    pub fn link(&self, name: &str, target: &Path) -> io::Result<()> {
        Ok(rustix::fs::symlinkat(target, &self.fd, name)?)
    }
}

impl AsFd for Folder {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}
