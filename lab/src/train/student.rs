//! One training: the process set in lockstep, as `./vlaps up` starts it.

use std::fs::{self, File};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::Duration;

use anyhow::{Context, bail};
use shm_config::secret;
use supervisor::machine::signals::pause;

use super::doubts::doubts;
use super::examiner::Examiner;
use super::protocol::{Protocol, STEP_S};
use super::results::{self, Exam};
use crate::progress::Progress;
use crate::stop::Stop;
use stack::Clock;

/// From look to look at how far the training is.
const LOOK: Duration = Duration::from_millis(200);

/// How a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// After all its steps.
    Complete,
    /// A stop was asked for.
    Stopped {
        /// After this many steps.
        steps: u64,
    },
}

/// Trains for the steps that are missing, and evaluates every block.
///
/// # Errors
/// When the process set cannot be started or gives up, the learner does not come
/// to its last block, or the folder cannot be written.
pub fn train(protocol: &Protocol, stop: &Stop, clock: Clock) -> anyhow::Result<End> {
    let folder = &protocol.folder;
    shm_config::file::make_folders(folder).with_context(|| folder.display().to_string())?;
    let from_to = (results::steps(folder)?, protocol.steps);
    let name = format!("seed {}", protocol.seed);
    let mut progress = Progress::begin(name, "steps", from_to, clock)?;
    let mut examiner = Examiner::start(protocol, clock)?;
    let end = drive_all(protocol, stop, (&mut examiner, &mut progress))?;
    let end = match end {
        End::Stopped { .. } => {
            examiner.stop()?;
            end
        }
        End::Complete => {
            progress.now("evaluating the last blocks");
            let end = examiner.finish(stop)?;
            if let Some(exam) = results::exams(folder)?.last() {
                progress.now(&success(exam));
            }
            end
        }
    };
    progress.end();
    Ok(end)
}

/// With its block: training does not wait for evaluations, and may be ahead of it.
fn success(exam: &Exam) -> String {
    format!("success {:.2} after step {}", exam.success, exam.steps)
}

/// Drives process sets until the last block is learnt. One is enough unless the
/// learner dies so late that the last steps never reach it.
fn drive_all(
    protocol: &Protocol,
    stop: &Stop,
    (examiner, progress): (&mut Examiner, &mut Progress),
) -> anyhow::Result<End> {
    let folder = &protocol.folder;
    let mut tried = None;
    loop {
        let (steps, driven) = (results::steps(folder)?, results::driven(folder)?);
        if stop.is_asked() {
            return Ok(End::Stopped { steps });
        }
        if steps >= protocol.steps {
            return Ok(End::Complete);
        }
        if tried == Some((steps, driven)) {
            bail!("{}", without_progress(protocol, (steps, driven)));
        }
        tried = Some((steps, driven));
        let mut set = ProcessSet::start(protocol, driven)?;
        let is_well = watch(&mut set, protocol, stop, (examiner, progress))?;
        let steps = results::steps(folder)?;
        if stop.is_asked() || (is_well && set.was_stopped()) {
            return Ok(End::Stopped { steps });
        }
        if !is_well {
            bail!("{}", set.last_words(steps));
        }
    }
}

/// Two process sets in a row, and no block more: what stands in the way is in the
/// learner's log.
fn without_progress(protocol: &Protocol, (steps, driven): (u64, u64)) -> String {
    let log = protocol.folder.join("logs/learner.log");
    format!(
        "seed {}: {driven} of {} steps are driven, but the learner wrote no block after step \
         {steps}: {} ({}); --resume tries again",
        protocol.seed,
        protocol.steps,
        last_line(&log),
        log.display()
    )
}

/// The last line of a log that says something.
fn last_line(log: &Path) -> String {
    let text = fs::read_to_string(log).unwrap_or_default();
    let last = text.lines().rev().find(|line| !line.trim().is_empty());
    last.unwrap_or("its log is empty").into()
}

/// Looks at a process set until it has ended; whether it did so well.
fn watch(
    set: &mut ProcessSet,
    protocol: &Protocol,
    stop: &Stop,
    (examiner, progress): (&mut Examiner, &mut Progress),
) -> anyhow::Result<bool> {
    let mut said = results::steps(&protocol.folder)?;
    loop {
        pause(LOOK);
        if let Some(exam) = examiner.news()? {
            progress.note(success(&exam));
        }
        let blocks = results::blocks(&protocol.folder)?;
        for (steps, doubt) in doubts(&blocks, &protocol.config) {
            if steps > said {
                progress.warn(&format!(
                    "in the block up to step {steps} {}",
                    doubt.words()
                ));
            }
        }
        said = blocks.last().map_or(0, |block| block.steps);
        progress.at(said);
        if stop.is_asked() {
            set.stop();
        }
        if let Some(is_well) = set.ended()? {
            return Ok(is_well);
        }
    }
}

/// What the process set prints.
const DRIVE_LOG: &str = "drive.log";

/// `./vlaps up`, as a child.
struct ProcessSet {
    child: Child,
    folder: PathBuf,
    summary: PathBuf,
    is_stopping: bool,
}

impl ProcessSet {
    /// For the steps that are missing when so many are driven. Without any the
    /// learner was killed in the updates of its last block: it makes up for them
    /// when it is started, and no set drives less than a step.
    fn start(protocol: &Protocol, begun: u64) -> anyhow::Result<ProcessSet> {
        let mut config = protocol.config.clone();
        config.run.duration_s = protocol.steps.saturating_sub(begun).max(1) as f64 * STEP_S;
        // Another order of the training seeds, not the same first ones again.
        config.run.shuffle = config.run.shuffle.wrapping_add(begun);
        let file = protocol.file();
        fs::write(&file, toml::to_string(&config)?).with_context(|| file.display().to_string())?;
        let log = protocol.folder.join(DRIVE_LOG);
        // Behind what the sets before have said.
        let mut options = File::options();
        let output = options.create(true).append(true).open(&log);
        let output = output.with_context(|| log.display().to_string())?;
        let summary = protocol.folder.join(format!("summary-{begun}.json"));
        let child = Command::new(supervisor_path()?)
            .arg("up")
            .arg("--json")
            .arg(&summary)
            // The set ends when this process is killed.
            .args(["--parent", &std::process::id().to_string()])
            .arg("--config")
            .arg(&file)
            // Its gate may need a key.
            .stdin(secret::lend()?)
            .stdout(output.try_clone()?)
            .stderr(output)
            // Ctrl-C in the terminal is ours to pass on: twice would kill.
            .process_group(0)
            .spawn()
            .context("the process set")?;
        Ok(ProcessSet {
            child,
            folder: protocol.folder.clone(),
            summary,
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

    /// Another command stopped it, such as `./vlaps down`.
    fn was_stopped(&self) -> bool {
        let text = fs::read_to_string(&self.summary).unwrap_or_default();
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        summary["ended"] == "stopped"
    }

    /// Why it gave up.
    fn last_words(&self, steps: u64) -> String {
        let log = self.folder.join(DRIVE_LOG);
        format!(
            "the process set ended after {steps} steps: {} ({})",
            last_line(&log).trim_start_matches("error: "),
            log.display()
        )
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
