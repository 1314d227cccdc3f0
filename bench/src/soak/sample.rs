//! Resources of every process of a set at one tick, as the kernel counts them.

use std::fs;
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use anyhow::Context;
use shm_config::run::RunPaths;

/// Name of the row of the run's files in shared memory.
pub const SHARED_MEMORY: &str = "shared memory";

/// Resources of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Held {
    /// The program, or [`SHARED_MEMORY`].
    pub name: String,
    /// Process id; 0 for shared memory.
    pub pid: u32,
    /// Anonymous resident memory, kB; for shared memory the space that its files use.
    pub memory_kb: u64,
    /// All resident memory, kB, including mapped files and shared memory.
    pub resident_kb: u64,
    /// Of shared memory, the length of its files, kB: what may be used at most. 0 for a
    /// process.
    pub reserved_kb: u64,
    /// Open files.
    pub files: u64,
    /// Threads.
    pub threads: u64,
}

/// Resources of a set at one tick.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    /// The run's tick.
    pub tick: u64,
    /// All processes and the shared memory.
    pub held: Vec<Held>,
}

impl Sample {
    /// Header of the file of samples.
    pub const HEADER: &str = "tick,name,pid,memory_kb,resident_kb,reserved_kb,files,threads";

    /// Samples the supervisor, its children, and the run's shared memory.
    ///
    /// # Errors
    /// If the system does not provide the numbers.
    pub fn take(tick: u64, supervisor: u32, paths: &RunPaths) -> anyhow::Result<Self> {
        let mut held = Vec::new();
        for entry in fs::read_dir("/proc").context("/proc")?.flatten() {
            let name = entry.file_name();
            let Some(pid) = name.to_str().and_then(|name| name.parse::<u32>().ok()) else {
                continue;
            };
            // A process that ends meanwhile is left out.
            if let Some(one) = process(&entry.path(), pid, supervisor) {
                held.push(one);
            }
        }
        held.sort_by(|a, b| (&a.name, a.pid).cmp(&(&b.name, b.pid)));
        held.push(shared_memory(paths)?);
        Ok(Self { tick, held })
    }

    /// Writes one line per process to the file of samples.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, file: &mut impl Write) -> io::Result<()> {
        for held in &self.held {
            writeln!(
                file,
                "{},{},{},{},{},{},{},{}",
                self.tick,
                held.name,
                held.pid,
                held.memory_kb,
                held.resident_kb,
                held.reserved_kb,
                held.files,
                held.threads
            )?;
        }
        file.flush()
    }
}

/// The resources of a process if it is the supervisor or a child of it.
fn process(proc: &Path, pid: u32, supervisor: u32) -> Option<Held> {
    let status = fs::read_to_string(proc.join("status")).ok()?;
    let number = |key: &str| -> Option<u64> {
        let line = status.lines().find_map(|line| line.strip_prefix(key))?;
        line.split_whitespace().next()?.parse().ok()
    };
    if pid != supervisor && number("PPid:")? != u64::from(supervisor) {
        return None;
    }
    // The kernel cuts the process name at 15 characters; the command line is whole.
    let line = fs::read(proc.join("cmdline")).ok()?;
    let program = line.split(|byte| *byte == 0).next()?;
    let program = String::from_utf8_lossy(program);
    Some(Held {
        name: program.rsplit('/').next()?.into(),
        pid,
        memory_kb: number("RssAnon:")?,
        resident_kb: number("VmRSS:")?,
        reserved_kb: 0,
        files: fs::read_dir(proc.join("fd")).ok()?.count() as u64,
        threads: number("Threads:")?,
    })
}

fn shared_memory(paths: &RunPaths) -> anyhow::Result<Held> {
    let files = paths.shared_memory()?;
    let found = files.iter().filter_map(|file| fs::metadata(file).ok());
    // Most files reserve space that was never written: the blocks in use are counted apart.
    let (used, reserved) = found.fold((0, 0), |(used, reserved), data| {
        (used + data.blocks() * 512, reserved + data.len())
    });
    Ok(Held {
        name: SHARED_MEMORY.into(),
        pid: 0,
        memory_kb: used / 1024,
        resident_kb: used / 1024,
        reserved_kb: reserved / 1024,
        files: files.len() as u64,
        threads: 0,
    })
}
