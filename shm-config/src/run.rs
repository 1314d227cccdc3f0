//! The run: its name isolates it from every other on the machine.
//!
//! A run keeps all its files under one folder that only its user can enter, and
//! its shared memory under one prefix. Every process of the run holds a shared
//! lock on the folder's `alive` file for as long as it lives, whatever ends it;
//! the kernel drops the lock. So a run is provably dead exactly when somebody
//! can take that lock exclusively, and only then are its leftovers removed.

use std::fmt;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use rustix::fs::FlockOperation;

/// Longest path of a socket, bytes: the kernel's 108 less the closing zero.
const SOCKET_PATH_MAX: usize = 107;
/// What the library puts behind the prefix of a doorbell's socket: a number of 31 digits
/// (for the first 126 ports of a process), and ".event".
const SOCKET_NAME_MAX: usize = 31 + 6;

/// Tries to make a folder that others may be removing.
const CREATE_TRIES: u32 = 100;

/// Where shared memory appears as files.
pub const SHARED_MEMORY_DIR: &str = "/dev/shm";

/// The folder of a user's runs, by user id. In memory as the messages are: the library
/// synchronises some 130 small files of a start with the disk, if they are on one.
pub const USER_DIR: &str = "/dev/shm/vlaps-{user}";

/// What the shared-memory files of a run begin with. The closing '.' is in no
/// run name, so no prefix begins another.
pub const PREFIX: &str = "vlaps-{user}-{run}.";

/// The file within a run's folder whose shared lock every member holds.
pub const ALIVE_FILE: &str = "alive";
/// The resolved configuration.
const CONFIG_FILE: &str = "config.toml";
/// Where the library keeps who is there, and what they share.
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
    /// Somebody else owns the folder, or others may enter it.
    #[error(
        "{path}: belongs to user {owner} with mode {mode:o}, so it is not safe to use; remove it or ask its owner"
    )]
    NotOurs {
        /// The folder.
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

/// Where a run lives on this machine.
#[derive(Debug, Clone)]
pub struct RunPaths {
    name: RunName,
    user_dir: PathBuf,
}

/// A lock on one of the run's files, dropped with the value or the process.
#[derive(Debug)]
pub struct RunLock {
    file: File,
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
    pub fn all() -> Vec<Self> {
        let probe = Self::new(RunName("x".into()));
        let Ok(entries) = fs::read_dir(&probe.user_dir) else {
            return Vec::new();
        };
        let mut runs: Vec<_> = entries
            .flatten()
            .filter_map(|entry| entry.file_name().to_str()?.parse().ok())
            .map(Self::new)
            .collect();
        runs.sort_by(|a, b| a.name.0.cmp(&b.name.0));
        runs
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
        self.dir().join("supervisor")
    }

    /// The run's resolved configuration, as its processes read it.
    pub fn config_file(&self) -> PathBuf {
        self.dir().join(CONFIG_FILE)
    }

    /// Makes the run's folder if it is missing and checks that it is private.
    ///
    /// # Errors
    /// When it belongs to somebody else or cannot be made.
    pub fn create(&self) -> Result<(), RunError> {
        // Another run that ends may take the user's empty folder away between
        // the two steps; it cannot do so for ever.
        for _ in 0..CREATE_TRIES {
            match self.try_create() {
                Err(RunError::Io { source, .. }) if source.kind() == io::ErrorKind::NotFound => {}
                done => return done,
            }
        }
        self.try_create()
    }

    fn try_create(&self) -> Result<(), RunError> {
        for dir in [&self.user_dir, &self.dir()] {
            let io_error = |source| RunError::Io {
                path: dir.clone(),
                source,
            };
            match DirBuilder::new().mode(0o700).create(dir) {
                Ok(()) => {}
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(io_error(error)),
            }
            let metadata = fs::symlink_metadata(dir).map_err(io_error)?;
            let mode = metadata.permissions().mode() & 0o777;
            let ours = metadata.uid() == rustix::process::getuid().as_raw();
            if !ours || !metadata.is_dir() || mode & 0o077 != 0 {
                return Err(RunError::NotOurs {
                    path: dir.clone(),
                    owner: metadata.uid(),
                    mode,
                });
            }
        }
        Ok(())
    }

    /// Says that the calling process is part of the run, until it ends.
    ///
    /// # Errors
    /// When the file cannot be made or locked.
    pub fn hold_alive(&self) -> Result<RunLock, RunError> {
        self.create()?;
        let path = self.dir().join(ALIVE_FILE);
        let file = open_private(&path)?;
        match lock(&path, &file, FlockOperation::NonBlockingLockShared)? {
            true => Ok(RunLock { file }),
            false => Err(RunError::Io {
                path,
                source: io::Error::other("the run is being cleaned up; try again"),
            }),
        }
    }

    /// Takes the supervisor's place in the run; `None` when another supervisor
    /// of the same run lives. Its process id is left in the file.
    ///
    /// # Errors
    /// When the folder or the file cannot be used.
    pub fn hold_supervisor(&self) -> Result<Option<RunLock>, RunError> {
        self.create()?;
        let path = self.supervisor_file();
        let file = open_private(&path)?;
        if !lock(&path, &file, FlockOperation::NonBlockingLockExclusive)? {
            return Ok(None);
        }
        let io_error = |source| RunError::Io {
            path: path.clone(),
            source,
        };
        // A run that was just ending may have removed the file in between; a lock
        // on a file that nobody else finds would hold nothing.
        let locked = file.metadata().map_err(io_error)?.ino();
        match fs::metadata(&path) {
            Ok(metadata) if metadata.ino() == locked => {}
            _ => return self.hold_supervisor(),
        }
        fs::write(&path, format!("{}\n", std::process::id())).map_err(io_error)?;
        Ok(Some(RunLock { file }))
    }

    /// The file of a supervisor's lock is still where it was taken, and what a
    /// process needs to join the run is beside it: nobody has removed the run's
    /// files.
    pub fn is_held(&self, lock: &RunLock) -> bool {
        let found = fs::metadata(self.supervisor_file());
        let locked = lock.file.metadata();
        let same =
            matches!((found, locked), (Ok(found), Ok(locked)) if found.ino() == locked.ino());
        let needed = [ALIVE_FILE, CONFIG_FILE, NODES_DIR, SERVICES_DIR];
        same && needed.iter().all(|name| self.dir().join(name).exists())
    }

    /// The process id of the run's living supervisor; `None` when there is none.
    pub fn supervisor_pid(&self) -> Option<u32> {
        let path = self.supervisor_file();
        let file = File::open(&path).ok()?;
        if lock(&path, &file, FlockOperation::NonBlockingLockShared).ok()? {
            return None;
        }
        // The kernel knows who holds the lock; the file may have been written over.
        // Where the kernel tells nobody (another container), the file says it.
        let locks = fs::read_to_string("/proc/locks").unwrap_or_default();
        holder(&locks, &file.metadata().ok()?)
            .or_else(|| fs::read_to_string(path).ok()?.trim().parse().ok())
    }

    /// Removes what a dead run left behind; `None` when a process of the run
    /// lives. The caller holds the supervisor's lock or knows that none starts.
    ///
    /// # Errors
    /// When a leftover cannot be removed.
    pub fn clean_if_dead(&self) -> Result<Option<Leftovers>, RunError> {
        let mut leftovers = Leftovers::default();
        let alive = self.dir().join(ALIVE_FILE);
        if let Ok(file) = File::open(&alive)
            && !lock(&alive, &file, FlockOperation::NonBlockingLockExclusive)?
        {
            return Ok(None);
        }
        for path in self.shared_memory()? {
            leftovers.bytes += fs::metadata(&path).map_or(0, |metadata| metadata.blocks() * 512);
            remove(&path)?;
            leftovers.files += 1;
        }
        for entry in fs::read_dir(self.dir()).into_iter().flatten().flatten() {
            let path = entry.path();
            let keep = ["supervisor", ALIVE_FILE].map(|name| path.ends_with(name));
            if !keep.contains(&true) {
                leftovers.files += 1;
                remove(&path)?;
            }
        }
        remove(&alive)?;
        Ok(Some(leftovers))
    }

    /// The run's shared-memory files that exist now.
    ///
    /// # Errors
    /// When the folder of shared memory cannot be read.
    pub fn shared_memory(&self) -> Result<Vec<PathBuf>, RunError> {
        let dir = Path::new(SHARED_MEMORY_DIR);
        let prefix = self.prefix();
        let entries = fs::read_dir(dir).map_err(|source| RunError::Io {
            path: dir.into(),
            source,
        })?;
        Ok(entries
            .flatten()
            .filter(|entry| entry.file_name().to_string_lossy().starts_with(&prefix))
            .map(|entry| entry.path())
            .collect())
    }

    /// Closes shared memory that the library leaves open to every user (a counter
    /// of nodes, 16 bytes) to all but this one.
    pub(crate) fn make_private(&self) -> Result<(), RunError> {
        for path in self.shared_memory()? {
            match fs::set_permissions(&path, fs::Permissions::from_mode(0o600)) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => {
                    return Err(RunError::Io {
                        path,
                        source: error,
                    });
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Removes the run's folder after an orderly stop.
    pub fn remove_dir(&self) {
        // Best effort: what stays is an empty folder that the next start reuses.
        let _ = fs::remove_dir_all(self.dir());
        let _ = fs::remove_dir(&self.user_dir);
    }
}

/// What was removed of a dead run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Leftovers {
    /// Files.
    pub files: usize,
    /// Bytes of shared memory.
    pub bytes: u64,
}

fn open_private(path: &Path) -> Result<File, RunError> {
    OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .mode(0o600)
        .open(path)
        .map_err(|source| RunError::Io {
            path: path.into(),
            source,
        })
}

/// The process that holds the lock on a file, out of the kernel's list:
/// `1: FLOCK  ADVISORY  WRITE 4711 00:1b:5678 0 EOF`.
fn holder(locks: &str, metadata: &fs::Metadata) -> Option<u32> {
    let device = metadata.dev();
    let (major, minor) = (rustix::fs::major(device), rustix::fs::minor(device));
    let place = format!("{major:02x}:{minor:02x}:{}", metadata.ino());
    locks.lines().find_map(|line| {
        let words: Vec<_> = line.split_whitespace().collect();
        match words.as_slice() {
            [_, "FLOCK", _, "WRITE", pid, at, ..] if *at == place => {
                pid.parse().ok().filter(|pid| *pid > 0)
            }
            _ => None,
        }
    })
}

/// Tries to lock; `false` when somebody else holds it.
fn lock(path: &Path, file: &File, operation: FlockOperation) -> Result<bool, RunError> {
    match rustix::fs::flock(file, operation) {
        Ok(()) => Ok(true),
        Err(rustix::io::Errno::WOULDBLOCK) => Ok(false),
        Err(error) => Err(RunError::Io {
            path: path.into(),
            source: error.into(),
        }),
    }
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
