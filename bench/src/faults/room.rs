//! A room of its own: the campaign fills disks and shared memory, and no other process
//! on the machine shall notice. In a mount namespace of its own /dev/shm and the
//! folder of the user's runs are small private file systems; what is left in them
//! at the end is the campaign's, and goes with it.

use std::fs::{self, File, OpenOptions};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use shm_config::run::{SHARED_MEMORY_DIR, USER_DIR};
use shm_config::secret;

/// Says that this process is within its room already.
const WITHIN: &str = "VLAPS_FAULTS_WITHIN";

/// The private file systems, one within the other, mounted by a shell that becomes
/// this program again.
const FURNISH: &str = r#"
mount -t tmpfs -o size=256m,mode=1777 tmpfs /dev/shm &&
mkdir -p -m 700 "$RUNS" &&
mount -t tmpfs -o size=64m,mode=0700 tmpfs "$RUNS" &&
exec "$0" "$@"
"#;

/// Where a campaign works.
#[derive(Debug)]
pub struct Room {
    /// Folder that its sets run in.
    pub folder: PathBuf,
    /// Disk and shared memory are its own, so that they may be filled.
    pub is_private: bool,
    _folder: Option<tempfile::TempDir>,
}

impl Room {
    /// Goes into a room of its own where the machine grants one: this program then
    /// begins anew there, and the call does not return in the old one.
    ///
    /// # Errors
    /// When no folder can be made.
    pub fn enter() -> anyhow::Result<Self> {
        if std::env::var_os(WITHIN).is_some() {
            let folder = runs().join(".faults");
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
                .args(["sh", "-c", FURNISH])
                .arg(own)
                .args(std::env::args_os().skip(1))
                .env(WITHIN, "1")
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

/// The options of unshare(1) that this machine grants; `None` when it grants none.
/// Root keeps its rights outside, real-time priority among them.
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

/// All free space of a file system, taken until the value is dropped.
#[derive(Debug)]
pub struct Filler {
    path: PathBuf,
}

impl Filler {
    /// Fills the file system that holds a folder.
    ///
    /// # Errors
    /// When it cannot be filled.
    pub fn fill(folder: &Path) -> anyhow::Result<Self> {
        let filler = Self {
            path: folder.join("vlaps-faults-filler"),
        };
        let mut options = OpenOptions::new();
        let file = options.create(true).truncate(true).write(true);
        let file = file.open(&filler.path).context("the filler")?;
        // What others take or give back meanwhile is taken, too.
        for step in [1 << 20, 4096] {
            while take(&file, folder, step)? {}
        }
        Ok(filler)
    }
}

/// Takes what is free in whole steps; `false` when there is no step left.
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
        // Nothing else can be done about it here; the next fill would fail loudly.
        let _ = fs::remove_file(&self.path);
    }
}

/// Where shared memory is.
pub fn shared_memory() -> &'static Path {
    Path::new(SHARED_MEMORY_DIR)
}
