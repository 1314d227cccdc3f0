//! One training: the process set in lockstep, as `./vlaps up` starts it.

use std::fs::{self, File};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, bail};
use indicatif::{ProgressBar, ProgressStyle};
use supervisor::signals::pause;

use super::examiner::Examiner;
use super::protocol::{Protocol, STEP_S};
use super::results;
use crate::Clock;

/// From look to look at how far the training is.
const LOOK: Duration = Duration::from_millis(200);

/// How a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// After all its steps.
    Complete,
    /// Somebody stopped it.
    Stopped {
        /// After this many steps.
        steps: u64,
    },
}

/// Trains for the steps that are missing, and evaluates every block.
///
/// # Errors
/// When the process set cannot be started or gives up, or the folder cannot be
/// written.
pub fn train(protocol: &Protocol, clock: Clock) -> anyhow::Result<End> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).context("signals")?;
    }
    fs::create_dir_all(&protocol.folder)
        .with_context(|| format!("{}", protocol.folder.display()))?;
    let bar = ProgressBar::new(protocol.steps);
    let style = "seed {prefix}  {elapsed_precise} {wide_bar} {pos}/{len} steps, {eta} left  {msg}";
    bar.set_style(ProgressStyle::with_template(style)?);
    bar.set_prefix(protocol.seed.to_string());
    bar.enable_steady_tick(LOOK);
    let begun = results::steps(&protocol.folder)?;
    // Resumed: what was done before says nothing about how fast it goes now.
    bar.set_position(begun);
    bar.reset_eta();
    let mut examiner = Examiner::start(protocol, clock)?;
    let mut set = match begun < protocol.steps {
        true => Some(ProcessSet::start(protocol, begun)?),
        false => None,
    };
    let ended = loop {
        pause(LOOK);
        bar.set_position(results::steps(&protocol.folder)?);
        if let Some(exam) = examiner.news()? {
            bar.set_message(format!("success {:.2}", exam));
        }
        let ended = match &mut set {
            None => Some(true),
            Some(set) => {
                if stop.load(Ordering::Relaxed) {
                    set.stop();
                }
                set.ended()?
            }
        };
        if let Some(success) = ended {
            break success;
        }
    };
    let stopped = stop.load(Ordering::Relaxed);
    let steps = results::steps(&protocol.folder)?;
    if !ended && !stopped {
        let log = protocol.folder.join(DRIVE_LOG);
        let text = fs::read_to_string(&log).unwrap_or_default();
        let last = text.lines().rev().find(|line| !line.trim().is_empty());
        bail!(
            "the process set ended after {steps} steps: {} ({})",
            last.unwrap_or("without a word")
                .trim_start_matches("error: "),
            log.display()
        );
    }
    bar.set_message("evaluating the last blocks");
    match stopped {
        true => examiner.stop()?,
        false => examiner.finish()?,
    }
    bar.finish_and_clear();
    Ok(match steps < protocol.steps {
        true => End::Stopped { steps },
        false => End::Complete,
    })
}

/// What the process set prints.
const DRIVE_LOG: &str = "drive.log";

/// `./vlaps up`, as a child.
struct ProcessSet {
    child: Child,
    is_stopping: bool,
}

impl ProcessSet {
    fn start(protocol: &Protocol, begun: u64) -> anyhow::Result<ProcessSet> {
        let mut config = protocol.config.clone();
        config.run.duration_s = (protocol.steps - begun) as f64 * STEP_S;
        // Another order of the training seeds, not the same first ones again.
        config.run.shuffle = config.run.shuffle.wrapping_add(begun);
        let file = protocol.file();
        fs::write(&file, toml::to_string(&config)?).with_context(|| file.display().to_string())?;
        let log = protocol.folder.join(DRIVE_LOG);
        let output = File::create(&log).with_context(|| log.display().to_string())?;
        let child = Command::new(supervisor_path()?)
            .args(["up", "--json"])
            .arg(protocol.folder.join(format!("summary-{begun}.json")))
            .arg("--config")
            .arg(&file)
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            // Ctrl-C in the terminal is ours to pass on: twice would kill.
            .process_group(0)
            .spawn()
            .context("the process set")?;
        Ok(ProcessSet {
            child,
            is_stopping: false,
        })
    }

    /// Asks it to end in order, once: a second time would kill.
    fn stop(&mut self) {
        if !self.is_stopping {
            self.is_stopping = true;
            let id = i32::try_from(self.child.id()).ok();
            if let Some(id) = id.and_then(rustix::process::Pid::from_raw) {
                // It may have ended meanwhile.
                let _ = rustix::process::kill_process(id, rustix::process::Signal::TERM);
            }
        }
    }

    /// Whether it ended well, once it has ended.
    fn ended(&mut self) -> anyhow::Result<Option<bool>> {
        Ok(self.child.try_wait()?.map(|status| status.success()))
    }
}

impl Drop for ProcessSet {
    fn drop(&mut self) {
        // Only when training ends by an error: nothing is left to drive.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The supervisor stands beside this program.
fn supervisor_path() -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("the program's own place")?;
    let path = own
        .parent()
        .unwrap_or(Path::new("."))
        .join("vlaps-supervisor");
    if !path.exists() {
        bail!("{}: missing; `./vlaps train` builds it", path.display());
    }
    Ok(path)
}
