//! The ROS bridge of a row, and the foreign messages that flood its router.

use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Stdio};

use anyhow::{Context, bail};

use super::beside;

/// Foreign messages a second.
const FLOOD_HZ: u32 = 10_000;
/// How the programs are built.
const HINT: &str = "build it with cargo build --release --manifest-path ros/Cargo.toml --bins \
                    --examples --target-dir target";

/// The bridge of a row and the flood. Both end when it is dropped.
pub struct RowRos {
    programs: Vec<Child>,
}

impl RowRos {
    /// Starts a router that is flooded, subscribes to all that the bridge has, and starts the
    /// bridge of a run; `None` if it is not wanted.
    ///
    /// # Errors
    /// If the programs are not built.
    pub fn start(wanted: bool, (run, folder): (&str, &Path)) -> anyhow::Result<Option<Self>> {
        if !wanted {
            return Ok(None);
        }
        let router = {
            let free = TcpListener::bind("127.0.0.1:0")?;
            format!("tcp/{}", free.local_addr()?)
        };
        let settings = folder.join(format!("{run}-ros.toml"));
        std::fs::write(&settings, format!("router = {router:?}\n"))?;
        let release = std::env::current_exe()?;
        let flood = format!("flood={FLOOD_HZ}");
        let stand_in = release.with_file_name("examples").join("stand_in");
        let bridge = release.with_file_name("vlaps-ros");
        let mut row = Self {
            programs: Vec::new(),
        };
        let words = [router.as_str(), &flood, "subscribe"];
        for (program, words) in [(stand_in, &words[..]), (bridge, &[run][..])] {
            if !program.is_file() {
                bail!("{}: is missing; {HINT}", program.display());
            }
            let mut command = beside(&program.to_string_lossy());
            command.args(words).env("VLAPS_ROS", &settings);
            command.stdin(Stdio::null()).stdout(Stdio::null());
            let child = command.stderr(Stdio::null()).spawn();
            row.programs.push(child.context("cannot start it")?);
        }
        Ok(Some(row))
    }

    /// Ends both.
    ///
    /// # Errors
    /// If one has ended before.
    pub fn finish(mut self) -> anyhow::Result<()> {
        for program in &mut self.programs {
            if let Some(status) = program.try_wait()? {
                bail!("bridge or flood ended during the row: {status}");
            }
        }
        Ok(())
    }
}

impl Drop for RowRos {
    fn drop(&mut self) {
        for mut program in self.programs.drain(..) {
            if let Ok(None) = program.try_wait() {
                // Ours, and not waited for yet: the id is its own.
                let pid = rustix::process::Pid::from_child(&program);
                let _ = rustix::process::kill_process(pid, rustix::process::Signal::TERM);
                let _ = program.wait();
            }
        }
    }
}
