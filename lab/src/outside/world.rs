//! A world process: starts it, observes it, and kills it on drop.

use std::fs::File;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::Context;
use shm_config::config::Config;
use supervisor::cli::failure::Failure;
use supervisor::set::exit::Exit;
use supervisor::set::launch::Program;

/// A running world. Dropping it kills it.
pub struct WorldProcess {
    child: Child,
    log: PathBuf,
}

impl WorldProcess {
    /// Starts it as the supervisor does. Its configuration and its log are in the run's folder
    /// and are removed with it. The process dies with the calling thread.
    ///
    /// # Errors
    /// If its files cannot be written or its Python does not start.
    pub fn start(
        program: &Program,
        config: &Config,
        folder: &Path,
    ) -> anyhow::Result<WorldProcess> {
        let (path, log) = (folder.join("config.toml"), folder.join("world.log"));
        let text = toml::to_string(config).context("the world's configuration")?;
        std::fs::write(&path, text).with_context(|| path.display().to_string())?;
        let output = File::create(&log).with_context(|| log.display().to_string())?;
        let errors = output.try_clone()?;
        let child = Command::new(&program.path)
            .args(&program.script)
            .arg("--config")
            .arg(&path)
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(errors)
            // Its own group: Ctrl-C in the terminal reaches this program only.
            .process_group(0)
            .spawn()
            .with_context(|| program.path.display().to_string())?;
        Ok(WorldProcess { child, log })
    }

    /// The process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// The exit status; `None` while it runs. Never waits.
    ///
    /// # Errors
    /// If the system does not provide the status.
    pub fn ended(&mut self) -> anyhow::Result<Option<Exit>> {
        Ok(self.child.try_wait()?.map(Exit::from))
    }

    /// The error for a world that has ended early or hung: its last line of output.
    pub fn lost(&self, how: &dyn std::fmt::Display) -> Failure {
        let text = std::fs::read(&self.log).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        let mut lines = text.lines().rev().map(str::trim);
        let last = lines.find(|line| !line.is_empty());
        let last = last.unwrap_or("no output");
        Failure::GivenUp(format!("the simulator's world ended early, {how}: {last}"))
    }
}

impl Drop for WorldProcess {
    fn drop(&mut self) {
        // This fails only if the process has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
