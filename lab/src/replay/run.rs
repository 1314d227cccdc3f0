//! A replay from the first message of a recording to its last.

use anyhow::Context;
use serde::Serialize;
use shm_config::config::GateMode;
use shm_config::services::Process;
use stack::Clock;

use super::advice::Counsel;
use super::findings::{Difference, Findings, Tally};
use super::learning::Learners;
use super::messages::{Messages, Stretch};
use super::plans::Plans;
use super::source::{Source, next_stretch};
use super::ticks::Ticks;
use super::worlds::{Worlds, is_built_in};

/// What is replayed.
#[derive(Clone, Debug)]
pub struct Task {
    /// The processes that are recomputed.
    pub processes: Vec<Process>,
    /// The first tick of which differences are told.
    pub from: u64,
    /// The only tick of which they are told.
    pub tick: Option<u64>,
}

/// The processes that can be recomputed, in the order in which a tick goes through them.
pub const PROCESSES: [Process; 5] = [
    Process::World,
    Process::Planner,
    Process::Controller,
    Process::Gate,
    Process::Learner,
];

/// What a replay found.
#[derive(Clone, Debug, Serialize)]
pub struct Replayed {
    /// Ticks of the controller that were recorded from the first asked for on.
    pub ticks: u64,
    /// Messages that differ.
    pub different: u64,
    /// Bytes of them that differ.
    pub different_bytes: u64,
    /// The first of them; `None` when all bytes are equal.
    pub first_difference: Option<Difference>,
    /// The figures of each process.
    pub processes: Vec<ProcessRow>,
    /// Weights that proposed and whose files are not in the recording; their proposals are
    /// taken as recorded.
    pub missing_policies: Vec<String>,
    /// Why messages of a process could not be recomputed.
    pub not_recomputed: Vec<String>,
    /// Recorded time, s.
    pub recorded_s: f64,
    /// The first thousand differences.
    pub differences: Vec<Difference>,
}

/// The figures of one process.
#[derive(Clone, Debug, Serialize)]
pub struct ProcessRow {
    /// Its name.
    pub process: &'static str,
    /// How many of its messages were recomputed, and differ.
    #[serde(flatten)]
    pub tally: Tally,
}

/// What recomputes the processes that are asked for.
struct Checks {
    worlds: Option<Worlds>,
    plans: Option<Plans>,
    ticks: Option<Ticks>,
    counsel: Option<Counsel>,
    learners: Option<Learners>,
    missing: Vec<u64>,
}

impl Checks {
    fn new(task: &Task, source: &dyn Source, clock: Clock) -> anyhow::Result<Self> {
        let config = source.config();
        let is_asked = |process| task.processes.contains(&process);
        let has_gate = !matches!(
            config.gate.mode,
            GateMode::Expert | GateMode::Policy | GateMode::Human | GateMode::Takeover
        );
        let worlds = is_asked(Process::World) && is_built_in(config);
        let has_own_planner = config.programs.of(Process::Planner).is_none();
        let plans = (is_asked(Process::Planner) && has_own_planner).then(|| Plans::new(config));
        let learners = is_asked(Process::Learner) && config.learner.enabled;
        let learners = learners.then(|| Learners::new(config, source.offers()));
        Ok(Self {
            learners: learners.transpose()?,
            worlds: worlds.then(|| Worlds::new(config)),
            plans: plans.transpose()?,
            ticks: is_asked(Process::Controller).then(|| Ticks::new(config, clock)),
            counsel: (is_asked(Process::Gate) && has_gate).then(|| Counsel::new(config)),
            missing: Vec::new(),
        })
    }

    /// Reads the policies of which the steps of a stretch are the first.
    fn read_policies(
        &mut self,
        source: &mut dyn Source,
        messages: &Messages,
    ) -> anyhow::Result<()> {
        let Some(ticks) = &mut self.ticks else {
            return Ok(());
        };
        for hash in ticks.unknown_weights(messages) {
            if self.missing.contains(&hash) {
                continue;
            }
            match source.policy(hash)? {
                Some(policy) => ticks.add_policy(policy)?,
                None => self.missing.push(hash),
            }
        }
        Ok(())
    }

    /// Recomputes a stretch, the processes beside each other, while `meanwhile` runs.
    fn run<T: Send>(
        &mut self,
        stretch: &Stretch,
        task: &Task,
        meanwhile: impl FnOnce() -> T + Send,
    ) -> anyhow::Result<(Findings, T)> {
        let mut parts: [Findings; 5] = std::array::from_fn(|_| Findings::of_tick(task.tick));
        let [of_worlds, of_plans, of_ticks, of_counsel, of_learners] = &mut parts;
        let (from, mut learnt, mut done) = (task.from, Ok(()), None);
        rayon::in_place_scope(|scope| {
            scope.spawn(|_| done = Some(meanwhile()));
            if let Some(learners) = &mut self.learners {
                scope.spawn(|_| learnt = learners.check(stretch, from, of_learners));
            }
            if let Some(worlds) = &mut self.worlds {
                scope.spawn(move |_| worlds.check(stretch, from, of_worlds));
            }
            if let Some(plans) = &mut self.plans {
                scope.spawn(move |_| plans.check(stretch, from, of_plans));
            }
            if let Some(ticks) = &mut self.ticks {
                scope.spawn(move |_| ticks.check(stretch, from, of_ticks));
            }
            // Its judge stays on this thread.
            if let Some(counsel) = &mut self.counsel {
                counsel.check(stretch, from, of_counsel);
            }
        });
        learnt?;
        let mut all = Findings::default();
        parts.into_iter().for_each(|part| all.merge(part));
        let done = done.context("a thread ended early")?;
        Ok((all, done))
    }

    /// Why messages could not be recomputed.
    fn not_recomputed(&self) -> Vec<String> {
        let learner = self.learners.iter().filter_map(Learners::given_up);
        learner.map(|why| format!("learner: {why}")).collect()
    }
}

/// Replays a recording; `passed` is called with the instant of the run's clock, ns, that was
/// reached.
///
/// # Errors
/// When the recording cannot be read, or its configuration or a policy is refused.
pub fn replay(
    source: &mut dyn Source,
    task: &Task,
    clock: Clock,
    mut passed: impl FnMut(u64),
) -> anyhow::Result<Replayed> {
    let mut checks = Checks::new(task, source, clock)?;
    let mut findings = Findings::of_tick(task.tick);
    let mut before = Messages::default();
    let mut spare = Messages::default();
    let mut now = next_stretch(source, Messages::default())?;
    let mut after = next_stretch(source, Messages::default())?;
    let mut ticks = 0;
    let mut recorded_ns = 0;
    for number in 0.. {
        if now.is_empty() {
            break;
        }
        checks.read_policies(source, &now)?;
        let stretch = Stretch {
            now: &now,
            beside: [&before, &after],
            number,
        };
        // The next one is read meanwhile.
        let (found, later) = checks.run(&stretch, task, || next_stretch(source, spare))?;
        findings.merge(found);
        let later = later?;
        let steps = &now.steps.all;
        ticks += steps
            .iter()
            .filter(|step| is_asked(task, step.header.tick))
            .count() as u64;
        if let [first, .., last] = &steps[..] {
            recorded_ns += last
                .timings
                .started_ns
                .saturating_sub(first.timings.started_ns);
            passed(last.timings.started_ns);
        }
        let is_past = task.tick.is_some_and(|tick| {
            let all = |messages: &Messages| messages.steps.all.iter().all(|s| s.header.tick > tick);
            all(&now) && all(&after) && !now.steps.all.is_empty()
        });
        if is_past {
            break;
        }
        (spare, before, now, after) = (before, now, after, later);
    }
    Ok(Replayed {
        ticks,
        different: findings.different(),
        different_bytes: findings.bytes(),
        not_recomputed: checks.not_recomputed(),
        first_difference: findings.first().cloned(),
        processes: rows(&findings),
        missing_policies: checks
            .missing
            .iter()
            .map(|hash| format!("{hash:016x}"))
            .collect(),
        recorded_s: recorded_ns as f64 * 1e-9,
        differences: findings.differences().into_iter().cloned().collect(),
    })
}

fn is_asked(task: &Task, tick: u64) -> bool {
    tick >= task.from && task.tick.is_none_or(|only| only == tick)
}

fn rows(findings: &Findings) -> Vec<ProcessRow> {
    let mut tallies: Vec<_> = findings.tallies().collect();
    tallies.sort_by_key(|(process, _)| process.code());
    let row = |(process, tally): (Process, &Tally)| ProcessRow {
        process: process.word(),
        tally: tally.clone(),
    };
    tallies.into_iter().map(row).collect()
}
