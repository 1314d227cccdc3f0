//! Two users of one machine, for tests of what one can do to the other.
//!
//! The tests run in a mount namespace with its own shared memory, which needs root. The
//! users need no account: a process belongs to one of them by its user id alone.

use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::{env, fs};

use crate::{programs, skip_unless, until};

/// The user whose sets drive.
pub const VICTIM: u32 = 4242;
/// The other user of the machine.
pub const OTHER: u32 = 4243;

/// A command that runs longer than 60 s hangs.
const LIMIT: [&str; 3] = ["timeout", "--signal=KILL", "60"];
/// The exit code of a command that was ended for that.
const LATE: i32 = 137;

/// The requirements of a stage, tried once.
const PROBE: &str = "mount -t tmpfs tmpfs /dev/shm && \
    setpriv --reuid=4242 --regid=4242 --clear-groups true";

/// A folder and shared memory that only the test's own processes see.
pub struct Stage {
    holder: Child,
    folder: PathBuf,
}

impl Stage {
    /// Creates the stage; `None` where this is impossible, which is printed with the
    /// name of the skipped test.
    pub fn set(what: &str) -> Option<Self> {
        let why = format!("{what}: needs root, unshare and setpriv for a second user");
        if skip_unless(&["unshare", "-m", "sh", "-c", PROBE], &why) {
            return None;
        }
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        let folder = env::temp_dir().join(format!("vlaps-stage-{}-{count}", std::process::id()));
        fs::create_dir_all(folder.join("bin")).expect("a folder");
        let script = "mount -t tmpfs -o mode=1777 tmpfs /dev/shm && \
            mount --bind \"$1\" \"$2\" && echo set && exec sleep infinity";
        let mut holder = Command::new("unshare")
            .args(["-m", "sh", "-c", script, "sh"])
            .arg(programs())
            .arg(folder.join("bin"))
            .stdout(Stdio::piped())
            .spawn()
            .expect("unshare");
        let mut line = String::new();
        let said = holder.stdout.take().expect("its words");
        BufReader::new(said).read_line(&mut line).expect("a word");
        assert_eq!(line, "set\n", "the stage is not set");
        Some(Self { holder, folder })
    }

    /// A folder of a user on the stage, made if it is missing.
    pub fn folder(&self, user: u32, name: &str) -> PathBuf {
        let path = self.folder.join(name);
        fs::create_dir_all(&path).expect("a folder");
        std::os::unix::fs::chown(&path, Some(user), Some(user)).expect("root");
        path
    }

    /// A command of a user in a folder.
    pub fn command(&self, user: u32, folder: &Path, words: &[&str]) -> Command {
        let mut command = Command::new("nsenter");
        let id = user.to_string();
        command
            .args(["--target", &self.holder.id().to_string(), "--mount", "--"])
            .args(["env", "-C"])
            .arg(folder)
            .args(["setpriv", "--reuid", &id, "--regid", &id, "--clear-groups"])
            .args(words)
            .stdin(Stdio::null());
        command
    }

    /// Runs a shell command of a user; it must succeed.
    pub fn sh(&self, user: u32, script: &str) -> String {
        let words = [&LIMIT[..], &["sh", "-c", script]].concat();
        let output = self
            .command(user, Path::new("/"), &words)
            .output()
            .expect("a shell");
        let said = text(&output);
        assert!(output.status.success(), "{script}: {said}");
        said
    }

    /// Runs a command line of `vlaps` of a user; it must not hang.
    pub fn vlaps(&self, user: u32, folder: &Path, words: &[&str]) -> Output {
        let supervisor = self.supervisor();
        let line = [&LIMIT[..], &[supervisor.as_str()], words].concat();
        let output = self
            .command(user, folder, &line)
            .output()
            .expect("the supervisor starts");
        assert_ne!(output.status.code(), Some(LATE), "{words:?} hangs");
        output
    }

    fn supervisor(&self) -> String {
        let path = self.folder.join("bin/vlaps-supervisor");
        path.to_str().expect("UTF-8").into()
    }

    /// Starts a set of a user that drives until it is stopped, and waits until it
    /// drives.
    pub fn drive(&self, user: u32, folder: &Path, run: &str) -> Driving {
        let child = self
            .command(user, folder, &[&self.supervisor(), "up", "--run", run])
            .args(["--no-realtime", "--rate", "10"])
            .args(["--gate", "expert", "--seed", "3"])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .expect("the supervisor starts");
        let log = folder.join(format!("runs/{run}/logs/supervisor.log"));
        until("the set drives", || {
            let log = fs::read_to_string(&log).unwrap_or_default();
            log.contains("world: ready")
        });
        Driving(child)
    }
}

/// A set that drives on the stage.
pub struct Driving(Child);

impl Driving {
    /// Waits for its end and gives its exit code.
    pub fn wait(mut self) -> Option<i32> {
        self.0.wait().expect("an end").code()
    }
}

impl Drop for Driving {
    fn drop(&mut self) {
        // Its processes end with it.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        // The mounts are removed with the last process of the namespace.
        let _ = self.holder.kill();
        let _ = self.holder.wait();
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// The whole output of a command.
pub fn text(output: &Output) -> String {
    format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    )
}
