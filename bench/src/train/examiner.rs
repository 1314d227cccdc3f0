//! Episodes without intervention after every block, beside the training.

use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use anyhow::anyhow;
use shm_config::config::Config;

use super::protocol::{EVALUATION_SEED, Protocol};
use super::results::{Exam, Results, append_exam, exams, policies};
use crate::Clock;
use crate::arguments::{Train, WorldChoice};
use crate::eval::{Task, evaluate};
use crate::evaluation::Evaluation;
use crate::report::write_json;
use crate::seat::DriverKind;
use supervisor::signals::pause;

/// From look to look at new policies.
const LOOK: Duration = Duration::from_millis(100);

/// Policies come on.
const WATCH: u8 = 0;
/// No more come; those that are there are evaluated.
const FINISH: u8 = 1;
/// Nothing more is evaluated.
const STOP: u8 = 2;

/// A thread that evaluates each policy that appears.
pub struct Examiner {
    order: Arc<AtomicU8>,
    news: Receiver<f64>,
    thread: Option<JoinHandle<anyhow::Result<()>>>,
}

impl Examiner {
    /// Begins with the first policy that was not evaluated yet.
    ///
    /// # Errors
    /// When what was evaluated before cannot be read.
    pub fn start(protocol: &Protocol, clock: Clock) -> anyhow::Result<Examiner> {
        let order = Arc::new(AtomicU8::new(WATCH));
        let (send, news) = channel();
        let thread = {
            let (order, protocol) = (Arc::clone(&order), protocol.clone());
            std::thread::spawn(move || {
                watch(&protocol, clock, &order, |success| {
                    // Nobody may listen any more.
                    let _ = send.send(success);
                })
            })
        };
        Ok(Examiner {
            order,
            news,
            thread: Some(thread),
        })
    }

    /// The newest success rate, when there is a new one.
    ///
    /// # Errors
    /// When the thread has failed.
    pub fn news(&mut self) -> anyhow::Result<Option<f64>> {
        if self.thread.as_ref().is_some_and(JoinHandle::is_finished) {
            self.join()?;
        }
        Ok(self.news.try_iter().last())
    }

    /// Waits until every policy is evaluated.
    ///
    /// # Errors
    /// When the thread has failed.
    pub fn finish(mut self) -> anyhow::Result<()> {
        self.order.store(FINISH, Ordering::Relaxed);
        self.join()
    }

    /// Waits for the evaluation at hand only.
    ///
    /// # Errors
    /// When the thread has failed.
    pub fn stop(mut self) -> anyhow::Result<()> {
        self.order.store(STOP, Ordering::Relaxed);
        self.join()
    }

    fn join(&mut self) -> anyhow::Result<()> {
        match self.thread.take().map(JoinHandle::join) {
            None => Ok(()),
            Some(Ok(result)) => result,
            Some(Err(_)) => Err(anyhow!("the evaluation's thread panicked")),
        }
    }
}

fn watch(
    protocol: &Protocol,
    clock: Clock,
    order: &AtomicU8,
    mut tell: impl FnMut(f64),
) -> anyhow::Result<()> {
    let done = exams(&protocol.folder)?.last().map_or(0, |exam| exam.steps);
    let mut done = done;
    loop {
        let now = order.load(Ordering::Relaxed);
        if now == STOP {
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
        // While it drives, the other cores are the training's.
        let threads = match now {
            FINISH => std::thread::available_parallelism()?,
            _ => NonZeroUsize::MIN,
        };
        let task = Task {
            driver: driver(&path),
            world: WorldChoice::Sim,
            first_seed: EVALUATION_SEED,
            episodes: protocol.episodes,
            threads,
        };
        let exam = exam(&task, steps, &protocol.config, clock)?;
        append_exam(&protocol.folder, &exam)?;
        tell(exam.success);
        done = steps;
    }
}

/// Evaluates in the built-in world, whichever the training is in.
fn exam(task: &Task, steps: u64, config: &Config, clock: Clock) -> anyhow::Result<Exam> {
    let mut config = config.clone();
    config.world.simulator = shm_config::config::Simulator::BuiltIn;
    let drives = evaluate(task, &config, clock, |_| {})?;
    let evaluation = Evaluation::new(task, &drives);
    Ok(Exam {
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
    })
}

/// Evaluates the last policy of each seed on many episodes, once.
///
/// # Errors
/// When a policy cannot be read or a file not written.
pub fn examine_finals(
    arguments: &Train,
    results: &Results,
    out: &Path,
    clock: Clock,
) -> anyhow::Result<()> {
    for seed in &results.seeds {
        let Some((steps, path)) = policies(&seed.folder)?.pop() else {
            continue;
        };
        let file = seed.folder.join("final.json");
        let known = seed.last.as_ref().is_some_and(|last| {
            last.steps == steps && last.evaluation["episodes"] == arguments.final_episodes
        });
        if known || arguments.final_episodes == 0 {
            continue;
        }
        let protocol = Protocol::new(arguments, seed.seed, out)?;
        let task = Task {
            driver: driver(&path),
            world: WorldChoice::Sim,
            first_seed: EVALUATION_SEED,
            episodes: arguments.final_episodes,
            threads: std::thread::available_parallelism()?,
        };
        let mut config = protocol.config;
        config.world.simulator = shm_config::config::Simulator::BuiltIn;
        let drives = evaluate(&task, &config, clock, |_| {})?;
        let mut evaluation = serde_json::to_value(Evaluation::new(&task, &drives))?;
        evaluation["steps"] = steps.into();
        evaluation["driver"] = format!("policies/{steps:08}.onnx").into();
        write_json(&file, &evaluation)?;
    }
    Ok(())
}

fn driver(path: &Path) -> DriverKind {
    DriverKind::Policy(path.display().to_string().leak())
}
