//! One training: runs the process set in lockstep, as `./vlaps up` does.

use std::fs::{self, File};
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::Duration;

use anyhow::{Context, bail};
use shm_config::config::Config;
use shm_config::{Instant, secret};
use supervisor::machine::signals::pause;
use supervisor::subcommand::{say, write_json};

use super::evaluator::Evaluator;
use super::protocol::{Protocol, STEP_S};
use super::results::{self, BlockEvaluation};
use super::warnings::warnings;
use crate::actors::coordinate::{Coordinator, Notice, Watch};
use crate::actors::door::Door;
use crate::actors::tally::ActorsTally;
use crate::actors::tls::ListenerKeys;
use crate::fork::read_policy;
use crate::progress::Progress;
use crate::stop::Stop;
use stack::Clock;

/// Polling interval of the training's progress.
const LOOK: Duration = Duration::from_millis(200);

/// Looks at a process set that is to end, before it is killed: 10 s, twice what it takes to brake.
const LAST_LOOKS: u32 = 50;

/// Time between two writings of what the actors did, ns.
const KEPT_NS: u64 = 1_000_000_000;

/// How a training ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// All steps are trained.
    Complete,
    /// A stop was requested.
    Stopped {
        /// Number of trained steps.
        steps: u64,
    },
}

/// Trains for the missing steps and evaluates every block.
///
/// # Errors
/// If the process set cannot be started or fails, the learner does not reach its last
/// block, or the folder cannot be written.
pub fn train(protocol: &Protocol, stop: &Stop, clock: Clock) -> anyhow::Result<End> {
    let folder = &protocol.folder;
    shm_config::file::make_folders(folder).with_context(|| folder.display().to_string())?;
    let from_to = (results::steps(folder)?, protocol.steps);
    let name = format!("seed {}", protocol.seed);
    let mut progress = Progress::begin(name, "steps", from_to, clock)?;
    let mut evaluator = Evaluator::start(protocol, clock)?;
    let watch = (&mut evaluator, &mut progress);
    let (end, tally) = match protocol.actors {
        Some(actors) => with_actors(protocol, actors, (stop, clock), watch)?,
        None => (drive_all(protocol, stop, watch)?, None),
    };
    let end = match end {
        End::Stopped { .. } => {
            evaluator.stop()?;
            end
        }
        End::Complete => {
            progress.now("evaluating the last blocks");
            let end = evaluator.finish(stop)?;
            if let Some(block_evaluation) = results::block_evaluations(folder)?.last() {
                progress.now(&success(block_evaluation));
            }
            end
        }
    };
    progress.end();
    if let Some(tally) = tally {
        say(tally.table());
        say(tally.line());
    }
    Ok(end)
}

/// Names the evaluated step: training does not wait for evaluations and may be ahead.
fn success(block_evaluation: &BlockEvaluation) -> String {
    format!(
        "success {:.2} after step {}",
        block_evaluation.success, block_evaluation.steps
    )
}

/// Runs process sets until the last block is trained. More than one is needed only if the
/// learner dies so late that it never receives the last steps.
fn drive_all(
    protocol: &Protocol,
    stop: &Stop,
    (evaluator, progress): (&mut Evaluator, &mut Progress),
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
        let is_well = watch(&mut set, protocol, stop, (evaluator, progress))?;
        let steps = results::steps(folder)?;
        if stop.is_asked() || (is_well && set.was_stopped()) {
            return Ok(End::Stopped { steps });
        }
        if !is_well {
            bail!("{}", set.failure_message(steps));
        }
    }
}

/// The error after two process sets in a row without a new block; the learner's log has
/// the cause.
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

/// The last non-empty line of a log.
fn last_line(log: &Path) -> String {
    let text = fs::read_to_string(log).unwrap_or_default();
    let last = text.lines().rev().find(|line| !line.trim().is_empty());
    last.unwrap_or("empty log").into()
}

/// Watches a process set until it has ended; returns whether it succeeded.
fn watch(
    set: &mut ProcessSet,
    protocol: &Protocol,
    stop: &Stop,
    (evaluator, progress): (&mut Evaluator, &mut Progress),
) -> anyhow::Result<bool> {
    let mut said = results::steps(&protocol.folder)?;
    loop {
        pause(LOOK);
        said = look(protocol, said, (evaluator, progress))?;
        if stop.is_asked() {
            set.stop();
        }
        if let Some(is_well) = set.ended()? {
            return Ok(is_well);
        }
    }
}

/// Shows what is new: evaluations, blocks, and warnings about blocks after step `said`.
/// Returns the step up to which all is shown.
fn look(
    protocol: &Protocol,
    said: u64,
    (evaluator, progress): (&mut Evaluator, &mut Progress),
) -> anyhow::Result<u64> {
    if let Some(block_evaluation) = evaluator.news()? {
        progress.note(success(&block_evaluation));
    }
    let blocks = results::blocks(&protocol.folder)?;
    for (steps, warning) in warnings(&blocks, &protocol.config) {
        if steps > said {
            progress.warn(&format!(
                "in the block up to step {steps} {}",
                warning.words()
            ));
        }
    }
    let steps = blocks.last().map_or(0, |block| block.steps);
    progress.at(steps);
    Ok(steps)
}

/// Checks the policy that drives first, or unchanged if nothing is learnt, before a folder is
/// made.
///
/// # Errors
/// When there is none though nothing is learnt, or it is refused.
pub fn check_policy(config: &Config, clock: Clock) -> anyhow::Result<()> {
    let file = &config.policy.file;
    if !file.is_empty() {
        read_policy(Path::new(file), config, clock)?;
        learner::unchanged::policy(config)?;
    } else if config.learner.updates == 0 {
        bail!(
            "learner.updates=0 learns nothing: name the policy that drives with \
             --set policy.file=FILE.onnx"
        );
    }
    Ok(())
}

/// The port at which the actors of other machines join; `None` without them.
///
/// # Errors
/// When the address cannot be used, or the run has invited no actor.
pub fn open_door(protocol: &Protocol) -> anyhow::Result<Option<Door>> {
    let Some((address, run)) = &protocol.actors_at else {
        return Ok(None);
    };
    Door::open(address, ListenerKeys::of_run(run.as_ref())?).map(Some)
}

/// Trains with actors in place of a process set.
fn with_actors(
    protocol: &Protocol,
    actors: u32,
    (stop, clock): (&Stop, Clock),
    (evaluator, progress): (&mut Evaluator, &mut Progress),
) -> anyhow::Result<(End, Option<ActorsTally>)> {
    let folder = &protocol.folder;
    let learner = folder.join("learner");
    let mut said = results::steps(folder)?;
    if said >= protocol.steps {
        return Ok((End::Complete, None));
    }
    let file = protocol.file();
    fs::write(&file, toml::to_string(&protocol.config)?)
        .with_context(|| file.display().to_string())?;
    let door = open_door(protocol)?;
    if let Some((address, _)) = &protocol.actors_at {
        progress.tell(&format!("listens at {address}, where ./vlaps actor joins"));
    }
    let mut coordinator = Coordinator::new(&protocol.config, &learner, (actors, door))?;
    let file = folder.join("actors.json");
    let earlier = fs::read(&file).unwrap_or_default();
    let earlier: ActorsTally = serde_json::from_slice(&earlier).unwrap_or_default();
    let keep = |tally: &ActorsTally| {
        let mut tally = tally.clone();
        tally.add(&earlier);
        write_json(&file, &tally).map(|()| tally)
    };
    let (mut shown, mut kept) = (clock(), Instant(0));
    let mut show = |notices: &[Notice], tally: &ActorsTally| {
        for notice in notices {
            match notice {
                Notice::News(line) => progress.tell(line),
                Notice::Warning(line) => progress.warn(line),
            }
        }
        if clock().since_ns(shown) < LOOK.as_nanos() as u64 {
            return Ok(());
        }
        shown = clock();
        if shown.since_ns(kept) >= KEPT_NS {
            kept = shown;
            keep(tally)?;
        }
        said = look(protocol, said, (&mut *evaluator, &mut *progress))?;
        Ok(())
    };
    let watch = Watch {
        clock,
        stop,
        look: &mut show,
    };
    let trained = coordinator.train((&learner, protocol.steps), watch);
    let tally = keep(&coordinator.finish())?;
    trained?;
    look(protocol, said, (evaluator, progress))?;
    let steps = results::steps(folder)?;
    let end = match steps >= protocol.steps {
        true => End::Complete,
        false => End::Stopped { steps },
    };
    Ok((end, Some(tally)))
}

/// File for the output of the process set.
const DRIVE_LOG: &str = "drive.log";

/// A running `./vlaps up`.
struct ProcessSet {
    child: Child,
    folder: PathBuf,
    summary: PathBuf,
    is_stopping: bool,
}

impl ProcessSet {
    /// Starts a set for the missing steps; `begun` are driven. If all are driven, the learner
    /// was killed during the updates of its last block; it makes them up at its start, and the
    /// set drives one step, the minimum.
    fn start(protocol: &Protocol, begun: u64) -> anyhow::Result<ProcessSet> {
        let mut config = protocol.config.clone();
        config.run.duration_s = protocol.steps.saturating_sub(begun).max(1) as f64 * STEP_S;
        // Begin with another part of the shuffled training seeds, not with the same ones again.
        config.run.shuffle = config.run.shuffle.wrapping_add(begun);
        let file = protocol.file();
        fs::write(&file, toml::to_string(&config)?).with_context(|| file.display().to_string())?;
        let log = protocol.folder.join(DRIVE_LOG);
        // Append to the output of earlier sets.
        let mut options = File::options();
        let output = options.create(true).append(true).open(&log);
        let output = output.with_context(|| log.display().to_string())?;
        let summary = protocol.folder.join(format!("summary-{begun}.json"));
        let child = Command::new(supervisor_path()?)
            .arg("up")
            .arg("--json")
            .arg(&summary)
            // The set ends if this process is killed.
            .args(["--parent", &std::process::id().to_string()])
            .arg("--config")
            .arg(&file)
            // The gate may need an API key from the environment.
            .stdin(secret::lend()?)
            .stdout(output.try_clone()?)
            .stderr(output)
            // Ctrl-C is forwarded once; a second signal would kill the set.
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

    /// Requests a stop once; a second request would kill the set.
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

    /// Whether another command stopped it, such as `./vlaps down`.
    fn was_stopped(&self) -> bool {
        let text = fs::read_to_string(&self.summary).unwrap_or_default();
        let summary: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        summary["ended"] == "stopped"
    }

    /// The error of a set that failed.
    fn failure_message(&self, steps: u64) -> String {
        let log = self.folder.join(DRIVE_LOG);
        format!(
            "the process set ended after {steps} steps: {} ({})",
            last_line(&log).trim_start_matches("error: "),
            log.display()
        )
    }

    /// Whether it succeeded, once it has ended.
    fn ended(&mut self) -> anyhow::Result<Option<bool>> {
        Ok(self.child.try_wait()?.map(|status| status.success()))
    }
}

impl Drop for ProcessSet {
    fn drop(&mut self) {
        // If training fails, the set still drives: it brakes and removes its shared memory.
        for _ in 0..LAST_LOOKS {
            if !matches!(self.child.try_wait(), Ok(None)) {
                return;
            }
            self.stop();
            pause(LOOK);
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Path of the supervisor, which is beside this program.
fn supervisor_path() -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("the path of this program")?;
    let path = own
        .parent()
        .unwrap_or(Path::new("."))
        .join("vlaps-supervisor");
    if !path.exists() {
        bail!("{}: missing; `./vlaps train` builds it", path.display());
    }
    Ok(path)
}
