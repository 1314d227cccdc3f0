//! Load beside a set: by `stress-ng` where it is installed, otherwise by threads of this
//! program.

use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::process::{Child, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;

use anyhow::Context;
use rustix::process::{Pid, Signal, kill_process};

use super::arguments::{Beside, StressChoice};

/// Bytes that each thread of `memory` copies: more than caches hold.
const MEMORY_BYTES: usize = 64 << 20;
/// Distance between touched bytes: a cache line.
const LINE: usize = 64;
/// Bytes written between two syncs of `disk`.
const CHUNK: usize = 1 << 20;
/// Chunks per file; then the file is written again from its begin.
const CHUNKS: u64 = 64;
/// Seconds after a row's end after which stress-ng ends by itself, in case this program
/// is killed before it ends it.
pub const SPARE_S: f64 = 90.0;
/// Folder of the disk load's files, within that of `--out`.
const FILES: &str = ".load";

/// The program that produces the load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Maker {
    /// stress-ng.
    StressNg,
    /// Threads of this program.
    Own,
}

impl Maker {
    /// The program of a choice.
    ///
    /// # Errors
    /// If stress-ng is requested but not installed.
    pub fn of(choice: StressChoice) -> anyhow::Result<Self> {
        let is_there = || super::answers("stress-ng", &["--version"]);
        match choice {
            StressChoice::Own => Ok(Self::Own),
            StressChoice::Auto if !is_there() => Ok(Self::Own),
            StressChoice::StressNg if !is_there() => anyhow::bail!(
                "--stress stress-ng: it is not on PATH; `sudo apt-get install stress-ng`, or \
                 --stress own"
            ),
            StressChoice::Auto | StressChoice::StressNg => Ok(Self::StressNg),
        }
    }

    /// Name of the program.
    pub fn word(self) -> &'static str {
        match self {
            Self::StressNg => "stress-ng",
            Self::Own => "own threads",
        }
    }
}

/// A load that ends when this value is dropped.
pub struct Stress {
    child: Option<Child>,
    threads: Vec<JoinHandle<()>>,
    stop: Arc<AtomicBool>,
    done: Arc<AtomicU64>,
    _folder: tempfile::TempDir,
}

impl Stress {
    /// Starts the load of a row. The disk load writes its files into a folder within `disk`;
    /// other temporary files go to `scratch`.
    ///
    /// # Errors
    /// If a program or thread cannot be started, or a file cannot be created.
    pub fn begin(
        beside: &Beside,
        (maker, seconds): (Maker, f64),
        (scratch, disk): (&Path, &Path),
    ) -> anyhow::Result<Self> {
        let place = if beside.disk { disk } else { scratch };
        let mut folder = tempfile::Builder::new();
        // A fixed name, so that a later run finds what a killed benchmark left.
        let folder = folder.prefix(FILES).rand_bytes(0).tempdir_in(place);
        let folder = folder.with_context(|| place.join(FILES).display().to_string())?;
        let mut stress = Self {
            child: None,
            threads: Vec::new(),
            stop: Arc::default(),
            done: Arc::default(),
            _folder: folder,
        };
        if !(beside.cpu || beside.memory || beside.disk) {
            return Ok(stress);
        }
        match maker {
            Maker::StressNg => {
                stress.child = Some(stress_ng(beside, seconds, stress._folder.path())?)
            }
            Maker::Own => stress.begin_threads(beside)?,
        }
        Ok(stress)
    }

    fn begin_threads(&mut self, beside: &Beside) -> anyhow::Result<()> {
        let cores = std::thread::available_parallelism()?.get();
        for _ in 0..cores {
            if beside.cpu {
                self.thread("load-cpu", spin)?;
            }
            if beside.memory {
                self.thread("load-memory", copy)?;
            }
        }
        if beside.disk {
            let path = self._folder.path().join("load");
            let file = File::create(&path).with_context(|| path.display().to_string())?;
            self.thread("load-disk", move |stop, done| write(&file, stop, done))?;
        }
        Ok(())
    }

    fn thread(
        &mut self,
        name: &str,
        work: impl FnOnce(&AtomicBool, &AtomicU64) + Send + 'static,
    ) -> anyhow::Result<()> {
        let (stop, done) = (self.stop.clone(), self.done.clone());
        let thread = std::thread::Builder::new().name(name.into());
        let thread = thread.spawn(move || work(&stop, &done));
        self.threads.push(thread.context("a thread for the load")?);
        Ok(())
    }

    /// Checks that the load is still running.
    ///
    /// # Errors
    /// If it ended by itself: the row was measured without it.
    pub fn check(&mut self) -> anyhow::Result<()> {
        if let Some(child) = &mut self.child
            && let Some(status) = child.try_wait()?
        {
            anyhow::bail!(
                "stress-ng ended early ({status}): the row has no load; run it by hand to see \
                 the reason, or use --stress own"
            );
        }
        if !self.threads.is_empty() && self.done.load(Ordering::Relaxed) == 0 {
            anyhow::bail!("the load's threads have done nothing: the row has no load");
        }
        Ok(())
    }
}

impl Drop for Stress {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(child) = &mut self.child {
            // Its child processes end with it.
            if let Some(pid) = Pid::from_raw(child.id() as i32) {
                let _ = kill_process(pid, Signal::TERM);
            }
            let _ = child.wait();
        }
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Removes load files that a killed benchmark left on the disk.
pub fn remove_stale(disk: &Path) {
    // A failed removal is reported when the next row starts its load.
    let _ = std::fs::remove_dir_all(disk.join(FILES));
}

fn stress_ng(beside: &Beside, seconds: f64, folder: &Path) -> anyhow::Result<Child> {
    let mut command = super::beside("stress-ng");
    let end_s = (seconds + SPARE_S).ceil().to_string();
    command.args(["--quiet", "--timeout", &end_s, "--temp-path"]);
    command.arg(folder);
    // 0: as many as there are cores.
    if beside.cpu {
        command.args(["--cpu", "0"]);
    }
    if beside.memory {
        command.args(["--stream", "0", "--vm", "1", "--vm-bytes", "256M"]);
    }
    if beside.disk {
        command.args(["--hdd", "1", "--hdd-bytes", "128M", "--hdd-opts", "fsync"]);
    }
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .context("stress-ng")
}

/// Arithmetic that the compiler cannot remove.
fn spin(stop: &AtomicBool, done: &AtomicU64) {
    let mut number = 1.0_f64;
    while !stop.load(Ordering::Relaxed) {
        for _ in 0..100_000 {
            number = std::hint::black_box((number + 1.0).sqrt());
        }
        done.fetch_add(1, Ordering::Relaxed);
    }
}

/// Copies between the halves of a buffer: first one byte of each cache line, then all
/// bytes.
fn copy(stop: &AtomicBool, done: &AtomicU64) {
    let mut buffer = vec![1_u8; MEMORY_BYTES];
    while !stop.load(Ordering::Relaxed) {
        let (to, from) = buffer.split_at_mut(MEMORY_BYTES / 2);
        for line in (0..to.len()).step_by(LINE) {
            to[line] = from[line].wrapping_add(1);
        }
        from.copy_from_slice(to);
        std::hint::black_box(&mut buffer);
        done.fetch_add(1, Ordering::Relaxed);
    }
}

/// Writes a file repeatedly and syncs each chunk to the disk.
fn write(mut file: &File, stop: &AtomicBool, done: &AtomicU64) {
    use std::io::{Seek, SeekFrom};
    let chunk = vec![7_u8; CHUNK];
    let mut chunks = 0_u64;
    while !stop.load(Ordering::Relaxed) {
        if chunks.is_multiple_of(CHUNKS) && file.seek(SeekFrom::Start(0)).is_err() {
            return;
        }
        // A full disk ends the load; `check` reports that nothing was done.
        if file.write_all(&chunk).is_err() || file.sync_data().is_err() {
            return;
        }
        chunks += 1;
        done.fetch_add(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latency::arguments::Load;
    use std::process::Command;
    use std::time::Duration;

    fn works(maker: Maker, load: Load) {
        let (scratch, disk) = folders();
        let row = load.rows()[0];
        let places = (scratch.path(), disk.path());
        let mut stress = Stress::begin(&row, (maker, 1.0), places).expect("a load");
        let is_on_disk = disk.path().join(FILES).exists();
        assert_eq!(is_on_disk, row.disk, "files are where the disk is loaded");
        let mut looks = 0;
        // The first pass may take a while on a busy machine.
        while stress.check().is_err() && maker == Maker::Own && looks < 600 {
            supervisor::machine::signals::pause(Duration::from_millis(100));
            looks += 1;
        }
        supervisor::machine::signals::pause(Duration::from_millis(300));
        stress.check().expect("it works");
        drop(stress);
        for folder in [scratch, disk] {
            let left = std::fs::read_dir(folder.path()).expect("a folder").count();
            assert_eq!(left, 0, "it leaves nothing behind");
        }
    }

    fn folders() -> (tempfile::TempDir, tempfile::TempDir) {
        let folder = || tempfile::tempdir().expect("a folder");
        (folder(), folder())
    }

    #[test]
    fn what_a_killed_benchmark_left_on_the_disk_is_removed() {
        let (_, disk) = folders();
        let left = disk.path().join(FILES);
        std::fs::create_dir(&left).expect("a folder");
        std::fs::write(left.join("load"), [7; 16]).expect("a file");
        remove_stale(disk.path());
        assert!(!left.exists());
    }

    #[test]
    fn own_threads_load_processor_memory_and_disk() {
        for load in [Load::Cpu, Load::Memory, Load::Disk] {
            works(Maker::Own, load);
        }
    }

    #[test]
    fn stress_ng_loads_all_three_at_once() {
        match Maker::of(StressChoice::StressNg) {
            Ok(maker) => works(maker, Load::All),
            Err(error) => println!("skipped: stress_ng_loads_all_three_at_once: {error}"),
        }
    }

    #[test]
    fn a_load_that_has_ended_is_an_error() {
        let (scratch, disk) = folders();
        let row = Load::None.rows()[0];
        let places = (scratch.path(), disk.path());
        let mut stress = Stress::begin(&row, (Maker::Own, 1.0), places).expect("no load");
        stress.check().expect("nothing was asked for");
        stress.child = Some(Command::new("true").spawn().expect("true"));
        let mut looks = 0;
        while stress.check().is_ok() && looks < 600 {
            supervisor::machine::signals::pause(Duration::from_millis(50));
            looks += 1;
        }
        assert!(stress.check().is_err());
    }
}
