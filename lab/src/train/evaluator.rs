//! Evaluates policies without intervention after every block, beside the training.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::anyhow;
use shm_config::config::{Config, Simulator};

use super::experiment::Experiment;
use super::protocol::{EVALUATION_SEED, Protocol};
use super::results::{
    BlockEvaluation, FinalSeeds, Results, append_block_evaluation, block_evaluations, policies,
};
use super::training::End;
use crate::episodes::{Task, evaluate_inside};
use crate::evaluation::Evaluation;
use crate::outcomes::WorldSettings;
use crate::progress::Progress;
use crate::stop::Stop;
use stack::Clock;
use stack::driver::DriverKind;
use supervisor::machine::signals::pause;
use supervisor::subcommand::write_json;

/// Polling interval for new policies.
const LOOK: Duration = Duration::from_millis(100);

/// Lowest priority that the system has.
const NICE: i32 = 19;

/// Number of progress lines of a last policy's evaluation.
const PARTS: u64 = 20;

/// More policies will come.
const WATCH: u8 = 0;
/// No more policies will come; the remaining ones are evaluated.
const FINISH: u8 = 1;

/// A thread that evaluates each new policy.
pub struct Evaluator {
    order: Arc<AtomicU8>,
    /// Separate from the training's: a stop request lets the training end in order first.
    stop: Stop,
    protocol: Protocol,
    news: Receiver<BlockEvaluation>,
    thread: Option<JoinHandle<anyhow::Result<()>>>,
}

impl Evaluator {
    /// Starts with the first policy that has not been evaluated.
    ///
    /// # Errors
    /// If the earlier evaluations cannot be read.
    pub fn start(protocol: &Protocol, clock: Clock) -> anyhow::Result<Evaluator> {
        let (order, stop) = (Arc::new(AtomicU8::new(WATCH)), Stop::default());
        let (send, news) = channel();
        let thread = {
            let (order, stop, protocol) = (Arc::clone(&order), stop.clone(), protocol.clone());
            std::thread::spawn(move || {
                give_way();
                watch(&protocol, clock, (&order, &stop), |block_evaluation| {
                    // The receiver may have been dropped.
                    let _ = send.send(block_evaluation);
                })
            })
        };
        Ok(Evaluator {
            order,
            stop,
            protocol: protocol.clone(),
            news,
            thread: Some(thread),
        })
    }

    /// The newest evaluation that has not been returned yet.
    ///
    /// # Errors
    /// If the thread has failed.
    pub fn news(&mut self) -> anyhow::Result<Option<BlockEvaluation>> {
        if self.thread.as_ref().is_some_and(JoinHandle::is_finished) {
            self.join()?;
        }
        Ok(self.news.try_iter().last())
    }

    /// Waits until every policy is evaluated or a stop is requested.
    ///
    /// # Errors
    /// If the thread has failed.
    pub fn finish(mut self, stop: &Stop) -> anyhow::Result<End> {
        self.order.store(FINISH, Ordering::Relaxed);
        while !self.thread.as_ref().is_none_or(JoinHandle::is_finished) {
            if stop.is_asked() {
                let steps = self.protocol.steps;
                self.stop()?;
                return Ok(End::Stopped { steps });
            }
            pause(LOOK);
        }
        self.join()?;
        Ok(End::Complete)
    }

    /// Waits only for the current episodes; their evaluation begins anew at the next
    /// start.
    ///
    /// # Errors
    /// If the thread has failed.
    pub fn stop(mut self) -> anyhow::Result<()> {
        self.stop.ask();
        self.join()
    }

    fn join(&mut self) -> anyhow::Result<()> {
        match self.thread.take().map(JoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(_)) => Err(anyhow!("the evaluation thread panicked")),
        }
    }
}

/// Lowers the priority of this thread, and of those that it starts: the training alternates
/// between driving and learning, and waits for evaluations only at its end.
fn give_way() {
    // It may be low already.
    let _ = rustix::process::setpriority_process(None, NICE);
}

fn watch(
    protocol: &Protocol,
    clock: Clock,
    (order, stop): (&AtomicU8, &Stop),
    mut send: impl FnMut(BlockEvaluation),
) -> anyhow::Result<()> {
    let done = block_evaluations(&protocol.folder)?
        .last()
        .map_or(0, |block_evaluation| block_evaluation.steps);
    let mut done = done;
    loop {
        let now = order.load(Ordering::Relaxed);
        if stop.is_asked() {
            return Ok(());
        }
        let next = policies(&protocol.folder)?
            .into_iter()
            .find(|(steps, _)| *steps > done);
        let Some((steps, path)) = next else {
            if now == FINISH {
                return Ok(());
            }
            pause(LOOK);
            continue;
        };
        // While the set drives, the other cores belong to it.
        let threads = match now {
            FINISH => std::thread::available_parallelism()?,
            _ => NonZeroUsize::MIN,
        };
        let task = Task {
            driver: driver(&path),
            world: Simulator::BuiltIn,
            first_seed: EVALUATION_SEED,
            episodes: protocol.episodes,
            threads,
        };
        let Some(block_evaluation) =
            evaluate_block((&task, steps), &protocol.config, (clock, stop))?
        else {
            return Ok(());
        };
        append_block_evaluation(&protocol.folder, &block_evaluation)?;
        send(block_evaluation);
        done = steps;
    }
}

/// Evaluates a policy in the built-in world, whichever world the training uses; `None` if
/// stopped early.
fn evaluate_block(
    (task, steps): (&Task, u64),
    config: &Config,
    watch: (Clock, &Stop),
) -> anyhow::Result<Option<BlockEvaluation>> {
    let Some(evaluation) = evaluated(task, config, watch, |_| {})? else {
        return Ok(None);
    };
    Ok(Some(BlockEvaluation {
        steps,
        success: evaluation.success.mean,
        strict_success: evaluation.strict_success.mean,
        contact: evaluation.contact.mean,
        crash_last_step: evaluation.crash_last_step.mean,
        out_of_road: evaluation.out_of_road.mean,
        max_step: evaluation.max_step.mean,
        completion: evaluation.completion.mean,
        mean_length: evaluation.mean_length,
        mean_speed_mps: evaluation.mean_speed_mps,
    }))
}

fn evaluated(
    task: &Task,
    config: &Config,
    watch: (Clock, &Stop),
    mut done: impl FnMut(u64),
) -> anyhow::Result<Option<Evaluation>> {
    let mut config = config.clone();
    config.world.simulator = Simulator::BuiltIn;
    let mut count = 0;
    let drives = evaluate_inside(task, &config, watch, |_| {
        count += 1;
        done(count);
    })?;
    let is_whole = drives.episodes.len() as u64 == task.episodes;
    let settings = WorldSettings::of(&config.world, Simulator::BuiltIn);
    Ok(is_whole.then(|| Evaluation::new(task, settings, &drives)))
}

/// Evaluates the last policy of each training on many episodes of these seeds, once.
///
/// # Errors
/// If a policy cannot be read or a file cannot be written.
pub fn evaluate_finals(
    experiment: &Experiment,
    results: &Results,
    (out, seeds): (&Path, FinalSeeds),
    (clock, stop): (Clock, &Stop),
) -> anyhow::Result<End> {
    for seed in &results.seeds {
        let Some((steps, path)) = policies(&seed.folder)?.pop() else {
            continue;
        };
        let file = seed.folder.join(seeds.file());
        let episodes = experiment.final_episodes;
        let last = seed.final_on(seeds);
        let is_known = last.is_some_and(|last| last.evaluation["episodes"] == episodes);
        if is_known || episodes == 0 {
            continue;
        }
        let protocol = Protocol::new(experiment, (seed.seed, out))?;
        let task = Task {
            driver: driver(&path),
            world: Simulator::BuiltIn,
            first_seed: seeds.first(),
            episodes,
            threads: std::thread::available_parallelism()?,
        };
        let name = match seeds {
            FinalSeeds::Evaluation => format!("seed {}, last policy", seed.seed),
            FinalSeeds::HeldBack => format!("seed {}, held-back episodes", seed.seed),
        };
        let mut progress = Progress::begin(name, "episodes", (0, episodes), clock)?;
        let part = episodes.div_ceil(PARTS);
        let evaluation = evaluated(&task, &protocol.config, (clock, stop), |count| {
            if count.is_multiple_of(part) || count == episodes {
                progress.at(count);
            }
        })?;
        progress.end();
        let Some(evaluation) = evaluation else {
            return Ok(End::Stopped { steps });
        };
        let mut evaluation = serde_json::to_value(evaluation)?;
        evaluation["steps"] = steps.into();
        evaluation["driver"] = format!("policies/{steps:08}.onnx").into();
        write_json(&file, &evaluation)?;
    }
    Ok(End::Complete)
}

fn driver(path: &Path) -> DriverKind {
    DriverKind::Policy(path.display().to_string().leak())
}
