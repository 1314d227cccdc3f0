//! One world process: started, watched, and ended with the value.

use std::fs::File;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use anyhow::Context;
use shm_config::config::Config;
use supervisor::cli::failure::Failure;
use supervisor::set::exit::Exit;
use supervisor::set::launch::Script;

/// A world that drives. Dropping it kills it.
pub struct WorldProcess {
    child: Child,
    log: PathBuf,
}

impl WorldProcess {
    /// Starts it as the supervisor would; its configuration and its log lie in
    /// the run's folder and go with it. It dies with the calling thread.
    ///
    /// # Errors
    /// When its files cannot be written or its Python does not start.
    pub fn start(script: &Script, config: &Config, folder: &Path) -> anyhow::Result<WorldProcess> {
        let (path, log) = (folder.join("config.toml"), folder.join("world.log"));
        let text = toml::to_string(config).context("the world's configuration")?;
        std::fs::write(&path, text).with_context(|| path.display().to_string())?;
        let output = File::create(&log).with_context(|| log.display().to_string())?;
        let errors = output.try_clone()?;
        let child = Command::new(&script.interpreter)
            .arg(&script.file)
            .arg("--config")
            .arg(&path)
            .stdin(Stdio::null())
            .stdout(output)
            .stderr(errors)
            // Its own group: Ctrl-C in the terminal reaches this program only.
            .process_group(0)
            .spawn()
            .with_context(|| script.interpreter.display().to_string())?;
        Ok(WorldProcess { child, log })
    }

    /// Its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// How it ended; `None` while it has not. Never waits.
    ///
    /// # Errors
    /// When the system does not tell.
    pub fn ended(&mut self) -> anyhow::Result<Option<Exit>> {
        Ok(self.child.try_wait()?.map(Exit::from))
    }

    /// What to say when it is not there any more although it should be, or does
    /// nothing: its own last line.
    pub fn lost(&self, how: &dyn std::fmt::Display) -> Failure {
        let text = std::fs::read(&self.log).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        let mut lines = text.lines().rev().map(str::trim);
        let last = lines.find(|line| !line.is_empty());
        let last = last.unwrap_or("it said nothing");
        Failure::GivenUp(format!("MetaDrive's world ended early, {how}: {last}"))
    }
}

impl Drop for WorldProcess {
    fn drop(&mut self) {
        // Fails only when it has ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
