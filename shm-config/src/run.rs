//! The run: its name isolates it from every other on the machine.
//!
//! A run keeps all its files in one folder that only its user can enter, and its shared
//! memory under one prefix. Every process of the run holds a shared lock on the
//! folder's `alive` file for its whole life; the kernel releases the lock however the
//! process ends. So a run is dead exactly when a process can take that lock
//! exclusively, and only then are its leftovers removed.

mod holder;
mod lock;
mod opening;
mod shared;

use std::ffi::OsString;
use std::fmt;
use std::fs::{self, File};
use std::io;
use std::os::unix::ffi::OsStringExt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use rustix::fs::{Dir, FlockOperation};

pub use self::holder::{Holder, started};
pub use self::lock::RunLock;
use self::lock::{is_in_place, lock};
use self::shared::Shared;
pub use self::shared::Stranger;
use crate::file::{Access, Durable, Entry, Folder, NotOurs};

/// Longest path of a socket, bytes: the kernel's 108 less the closing zero.
const SOCKET_PATH_MAX: usize = 107;
/// The suffix that the library appends to the prefix of a doorbell's socket: a number
/// of 31 digits (for the first 126 ports of a process), and ".event".
const SOCKET_NAME_MAX: usize = 31 + 6;

/// Tries to make a folder that others may be removing.
const CREATE_TRIES: u32 = 100;

/// Where shared memory appears as files.
pub const SHARED_MEMORY_DIR: &str = "/dev/shm";

/// The folder of a user's runs, by user id. It is in memory, like the messages: on a
/// disk, the library would synchronise some 130 small files at each start.
pub const USER_DIR: &str = "/dev/shm/vlaps-{user}";

/// The prefix of the run's shared-memory files. No run name contains the closing '.',
/// so no prefix is the beginning of another.
pub const PREFIX: &str = "vlaps-{user}-{run}.";

/// The file within a run's folder whose shared lock every member holds.
pub const ALIVE_FILE: &str = "alive";
/// The resolved configuration.
const CONFIG_FILE: &str = "config.toml";
/// The supervisor's lock, with its process id.
const SUPERVISOR_FILE: &str = "supervisor";
/// A link to the folder of the run's logs and summary.
const FOLDER_LINK: &str = "folder";
/// The program with which the run ends, if a program started it.
const PARENT_FILE: &str = "parent";
/// Longest file of a number that is read back, bytes.
const NUMBER_BYTES_MAX: u64 = 64;
/// Where the library lists the processes and what they share.
const NODES_DIR: &str = "nodes";
const SERVICES_DIR: &str = "services";

/// The name of a run: 1 to [`name_max`] of `a-z`, `A-Z`, `0-9`, `-` and `_`.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct RunName(String);

/// A run name that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("run name {0:?}: use 1 to {max} letters, digits, '-' or '_'", max = name_max())]
pub struct InvalidRunName(String);

/// Longest run name of the calling user: 18 letters for a user id of four digits. Folder
/// and prefix hold both, and with them make the path of a doorbell's socket.
pub fn name_max() -> usize {
    let user = rustix::process::getuid().as_raw().to_string();
    let folder = USER_DIR.replace("{user}", &user).len() + "/".len();
    let prefix = PREFIX.replace("{user}", &user).replace("{run}", "").len() + "/".len();
    (SOCKET_PATH_MAX - SOCKET_NAME_MAX - folder - prefix) / 2
}

impl FromStr for RunName {
    type Err = InvalidRunName;

    fn from_str(name: &str) -> Result<Self, InvalidRunName> {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if name.is_empty() || name.len() > name_max() || !name.chars().all(plain) {
            return Err(InvalidRunName(name.into()));
        }
        Ok(Self(name.into()))
    }
}

impl fmt::Display for RunName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

/// Why a run's folder could not be used.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// Another user owns the folder or the file, or others may enter it.
    #[error(
        "{path}: belongs to user {owner} with mode {mode:o}, so it is not safe to use; remove it or ask its owner"
    )]
    NotOurs {
        /// The folder or the file.
        path: PathBuf,
        /// Its owner's user id.
        owner: u32,
        /// Its permission bits.
        mode: u32,
    },
    /// The file system refused.
    #[error("{path}: {source}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl RunError {
    fn of(path: &Path, source: io::Error) -> Self {
        let path = path.into();
        match NotOurs::within(&source).map(NotOurs::owner_and_mode) {
            Some((owner, mode)) => Self::NotOurs { path, owner, mode },
            None => Self::Io { path, source },
        }
    }

    /// There is nothing at the path.
    fn is_missing(&self) -> bool {
        matches!(self, Self::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
    }
}

/// Where a run lives on this machine.
#[derive(Debug, Clone)]
pub struct RunPaths {
    name: RunName,
    user_dir: PathBuf,
}

impl RunPaths {
    /// The paths of a run of the calling user.
    pub fn new(name: RunName) -> Self {
        let user = rustix::process::getuid().as_raw();
        Self {
            name,
            user_dir: PathBuf::from(USER_DIR.replace("{user}", &user.to_string())),
        }
    }

    /// All runs of the calling user that left a folder, dead or alive.
    ///
    /// # Errors
    /// When the folder of the user's runs is not the user's, or cannot be read.
    pub fn all() -> Result<Vec<Self>, RunError> {
        let probe = Self::new(RunName("x".into()));
        let folder = match probe.user_folder() {
            Ok(folder) => folder,
            Err(error) if error.is_missing() => return Ok(Vec::new()),
            Err(error) => return Err(error),
        };
        let entries = Dir::read_from(&folder)
            .map_err(|error| RunError::of(folder.path(), io::Error::from(error)))?;
        let mut runs: Vec<_> = entries
            .flatten()
            .filter_map(|entry| entry.file_name().to_str().ok()?.parse().ok())
            .map(Self::new)
            .collect();
        runs.sort_by(|a, b| a.name.0.cmp(&b.name.0));
        Ok(runs)
    }

    /// The run's name.
    pub fn name(&self) -> &RunName {
        &self.name
    }

    /// The run's folder, entered by its user only.
    pub fn dir(&self) -> PathBuf {
        self.user_dir.join(&self.name.0)
    }

    /// What every shared-memory file of the run begins with.
    pub fn prefix(&self) -> String {
        let user = rustix::process::getuid().as_raw();
        PREFIX
            .replace("{user}", &user.to_string())
            .replace("{run}", &self.name.0)
    }

    /// The file that holds the supervisor's process id while it lives.
    pub fn supervisor_file(&self) -> PathBuf {
        self.dir().join(SUPERVISOR_FILE)
    }

    /// The run's resolved configuration, as its processes read it.
    pub fn config_file(&self) -> PathBuf {
        self.dir().join(CONFIG_FILE)
    }

    /// Makes the run's folder if it is missing and checks that it is private.
    ///
    /// # Errors
    /// When it belongs to another user or cannot be made.
    pub fn create(&self) -> Result<(), RunError> {
        // Another run that ends may remove the user's empty folder between the two
        // steps, but not every time.
        for _ in 0..CREATE_TRIES {
            match self.try_create() {
                Err(RunError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => {}
                done => return done,
            }
        }
        self.try_create()
    }

    fn try_create(&self) -> Result<(), RunError> {
        let user = &self.user_dir;
        let user_folder =
            Folder::make(user, Entry::Private).map_err(|error| RunError::of(user, error))?;
        user_folder
            .make_inside(&self.name.0, Entry::Private)
            .map(drop)
            .map_err(|error| RunError::of(&self.dir(), error))
    }

    /// The folder of the user's runs.
    fn user_folder(&self) -> Result<Folder, RunError> {
        let path = &self.user_dir;
        Folder::open(path, Entry::Private).map_err(|error| RunError::of(path, error))
    }

    /// The run's folder, which must exist.
    fn folder(&self) -> Result<Folder, RunError> {
        self.user_folder()?
            .inside(&self.name.0, Entry::Private)
            .map_err(|error| RunError::of(&self.dir(), error))
    }

    /// Opens a file of the run's folder; both are made if they are missing.
    fn open_made(&self, name: &str) -> Result<File, RunError> {
        self.create()?;
        self.folder()?
            .open_file(name, Access::Change)
            .map_err(|error| RunError::of(&self.dir().join(name), error))
    }

    /// Writes beside the run's files where its logs are, and which program started it,
    /// if one did. Commands select a run by this.
    ///
    /// # Errors
    /// When the run's folder cannot be used.
    pub fn keep_origin(&self, origin: &Origin) -> Result<(), RunError> {
        let ours = self.folder()?;
        let failed = |error| RunError::of(&self.dir(), error);
        // A killed supervisor of this name may have left it.
        let _ = ours.remove(FOLDER_LINK);
        let _ = ours.remove(PARENT_FILE);
        ours.link(FOLDER_LINK, &origin.folder).map_err(failed)?;
        match origin.parent {
            Some(parent) => ours
                .replace(PARENT_FILE, parent.to_string().as_bytes(), Durable::No)
                .map_err(failed),
            None => Ok(()),
        }
    }

    /// Where the run was started; `None` when its supervisor has not written it.
    pub fn origin(&self) -> Option<Origin> {
        let ours = self.folder().ok()?;
        let folder = rustix::fs::readlinkat(&ours, FOLDER_LINK, Vec::new()).ok()?;
        let parent = ours.read_text(PARENT_FILE, NUMBER_BYTES_MAX);
        Some(Origin {
            folder: PathBuf::from(OsString::from_vec(folder.into_bytes())),
            parent: parent.ok().and_then(|text| text.trim().parse().ok()),
        })
    }

    /// Removes what a dead run left behind; `None` when a process of the run
    /// lives. The caller holds the supervisor's lock or knows that none starts.
    ///
    /// # Errors
    /// When a leftover cannot be removed.
    pub fn clean_if_dead(&self) -> Result<Option<Leftovers>, RunError> {
        let mut leftovers = Leftovers::default();
        let folder = match self.folder() {
            Ok(folder) => Some(folder),
            Err(error) if error.is_missing() => None,
            Err(error) => return Err(error),
        };
        let alive = self.dir().join(ALIVE_FILE);
        // A missing file is made, because a process that joins now would make and lock it.
        let file = folder.and_then(|folder| folder.open_file(ALIVE_FILE, Access::Change).ok());
        if let Some(file) = &file
            && !(lock(&alive, file, FlockOperation::NonBlockingLockExclusive)?
                && is_in_place(&alive, file)?)
        {
            return Ok(None);
        }
        (leftovers.bytes, leftovers.files) = Shared::look(&self.prefix())?.remove()?;
        for entry in fs::read_dir(self.dir()).into_iter().flatten().flatten() {
            let path = entry.path();
            let keep = [SUPERVISOR_FILE, ALIVE_FILE].map(|name| path.ends_with(name));
            if !keep.contains(&true) {
                leftovers.files += 1;
                remove(&path)?;
            }
        }
        remove(&alive)?;
        Ok(Some(leftovers))
    }

    /// Removes the folder of a run whose files are removed.
    pub fn remove_dir(&self) {
        // Only this user can rename the folder above it, so its path still leads to the
        // same folder.
        if self.user_folder().is_err() {
            return;
        }
        let _ = remove(&self.supervisor_file());
        // From here on another set may take the place, and a process may have joined since
        // it was cleaned: their files stay, and the folder with them.
        let _ = fs::remove_dir(self.dir());
        let _ = fs::remove_dir(&self.user_dir);
    }
}

/// Where a run was started.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Origin {
    /// The folder of its logs and summary, without links.
    pub folder: PathBuf,
    /// The program that started it, such as a training; `None` when a user did.
    pub parent: Option<u32>,
}

/// What was removed of a dead run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Leftovers {
    /// Files.
    pub files: usize,
    /// Bytes of shared memory.
    pub bytes: u64,
}

fn remove(path: &Path) -> Result<(), RunError> {
    let removed = match fs::symlink_metadata(path) {
        Ok(metadata) if metadata.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
        Err(error) => Err(error),
    };
    match removed {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(RunError::Io {
            path: path.into(),
            source: error,
        }),
        _ => Ok(()),
    }
}
