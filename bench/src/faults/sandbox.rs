//! Private file systems for a campaign: it fills disks and shared memory, and no other
//! process on the machine may notice. In a mount namespace of its own, /dev/shm and the
//! folder of the user's runs are small private file systems; their content disappears
//! with the namespace.

use std::fs::{self, File, OpenOptions};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use shm_config::run::{SHARED_MEMORY_DIR, USER_DIR};
use shm_config::secret;

/// Environment variable of a process that is inside the namespace already.
const INSIDE: &str = "VLAPS_FAULTS_WITHIN";

/// Mounts the private file systems, one within the other, and then executes this
/// program again.
const MOUNT_SCRIPT: &str = r#"
mount -t tmpfs -o size=256m,mode=1777 tmpfs /dev/shm &&
mkdir -p -m 700 "$RUNS" &&
mount -t tmpfs -o size=64m,mode=0700 tmpfs "$RUNS" &&
exec "$0" "$@"
"#;

/// The folder of a campaign.
#[derive(Debug)]
pub struct Sandbox {
    /// Folder in which its sets run.
    pub folder: PathBuf,
    /// Whether disk and shared memory are private, so that they may be filled.
    pub is_private: bool,
    _folder: Option<tempfile::TempDir>,
}

impl Sandbox {
    /// Enters a private mount namespace where the machine grants one: this program then
    /// starts anew inside it, and the call does not return.
    ///
    /// # Errors
    /// If the folder cannot be made.
    pub fn enter() -> anyhow::Result<Self> {
        if std::env::var_os(INSIDE).is_some() {
            // The set's processes are found by their folder, and processes in other mount
            // namespaces show theirs by the same paths: one name for all campaigns would
            // count the living set of another campaign as left behind.
            let folder = runs().join(format!(".faults-{}", std::process::id()));
            fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
            return Ok(Self {
                folder,
                is_private: true,
                _folder: None,
            });
        }
        if let Some(flags) = namespace() {
            let own = std::env::current_exe()?;
            let mut become_it = Command::new("unshare");
            secret::hand_on(&mut become_it);
            let error = become_it
                .args(flags)
                .args(["sh", "-c", MOUNT_SCRIPT])
                .arg(own)
                .args(std::env::args_os().skip(1))
                .env(INSIDE, "1")
                .env("RUNS", runs())
                .exec();
            bail!("unshare: {error}");
        }
        let folder = tempfile::tempdir()?;
        Ok(Self {
            folder: folder.path().into(),
            is_private: false,
            _folder: Some(folder),
        })
    }
}

fn runs() -> PathBuf {
    let user = rustix::process::getuid().as_raw();
    PathBuf::from(USER_DIR.replace("{user}", &user.to_string()))
}

/// The options of unshare(1) that this machine grants; `None` if it grants none. Root
/// keeps its privileges of the host, real-time priority among them.
fn namespace() -> Option<&'static [&'static str]> {
    let probe = "mount -t tmpfs tmpfs /dev/shm";
    [&["-m"][..], &["-rm"][..]].into_iter().find(|flags| {
        let status = Command::new("unshare")
            .args(*flags)
            .args(["sh", "-c", probe])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        status.is_ok_and(|status| status.success())
    })
}

/// Occupies all free space of a file system until dropped.
#[derive(Debug)]
pub struct Filler {
    path: PathBuf,
}

impl Filler {
    /// Fills the file system that holds a folder.
    ///
    /// # Errors
    /// If it cannot be filled.
    pub fn fill(folder: &Path) -> anyhow::Result<Self> {
        let filler = Self {
            path: folder.join("vlaps-faults-filler"),
        };
        let mut options = OpenOptions::new();
        let file = options.create(true).truncate(true).write(true);
        let file = file.open(&filler.path).context("the filler")?;
        // Space that other processes free meanwhile is filled, too.
        for step in [1 << 20, 4096] {
            while take(&file, folder, step)? {}
        }
        Ok(filler)
    }
}

/// Allocates free space in steps of `step` bytes; `false` when no whole step is left.
fn take(file: &File, folder: &Path, step: u64) -> anyhow::Result<bool> {
    let space = statvfs(folder)?;
    let free = space.f_bavail * space.f_frsize / step * step;
    if free == 0 {
        return Ok(false);
    }
    let length = file.metadata()?.len();
    match fallocate(file, FallocateFlags::empty(), length, free) {
        Ok(()) => Ok(true),
        Err(rustix::io::Errno::NOSPC) => Ok(false),
        Err(error) => Err(error).context("fallocate"),
    }
}

impl Drop for Filler {
    fn drop(&mut self) {
        // A failed removal cannot be handled here; the next fill would report it.
        let _ = fs::remove_file(&self.path);
    }
}

/// The folder of POSIX shared memory.
pub fn shared_memory() -> &'static Path {
    Path::new(SHARED_MEMORY_DIR)
}
