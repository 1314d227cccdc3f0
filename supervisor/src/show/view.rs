//! The state of a run now. One view serves the live block, the plain lines and
//! `./vlaps status`.

use std::collections::BTreeMap;

use serde::Serialize;
use shm_config::config::{Config, GateMode};
use shm_config::message::{HealthState, Outcome, Reason};
use shm_config::services::Process;

use crate::set::member::Phase;
use crate::set::process_set::ProcessSet;
use crate::set::table::rows;
use crate::show::clock::clock_word;
use crate::show::policy_view::PolicyView;
use crate::telemetry::process_tally::ProcessTally;
use crate::telemetry::tally::Tally;

/// The state of a run now.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct View {
    /// The run's name.
    pub run: String,
    /// The run's clock: real time or lockstep.
    pub clock: &'static str,
    /// Configured ticks of the run per second: the rate of the controller.
    pub rate_hz: f64,
    /// The current episode; `None` before the first tick.
    pub episode: Option<EpisodeView>,
    /// Driver and reason; `None` before the first step.
    pub driver: Option<(&'static str, &'static str)>,
    /// A human driver has taken over.
    pub is_person: bool,
    /// The world has no recent command and brakes.
    pub is_unled: bool,
    /// Messages that the world refused, by reason.
    pub world_refusals: BTreeMap<&'static str, u64>,
    /// The policy's weights; `None` when none were ever offered.
    pub policy: Option<PolicyView>,
    /// Finished episodes by outcome.
    pub outcomes: Vec<(&'static str, usize)>,
    /// Each process.
    pub processes: Vec<ProcessView>,
    /// The effect of the keys, for a human driver.
    #[serde(skip)]
    pub help: Option<String>,
}

/// The current episode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EpisodeView {
    /// Its number, from 1.
    pub number: u32,
    /// The number of episodes; 0 for no end.
    pub of: u32,
    /// Its seed.
    pub seed: u64,
    /// Share of the route driven, [0, 1].
    pub completion: f64,
    /// Speed, m/s.
    pub speed_mps: f64,
    /// Ticks of this run on which the world braked without a recent command.
    pub braked: u64,
}

/// One process.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProcessView {
    /// Its name.
    pub process: &'static str,
    /// Its state: from its health, or as the supervisor knows it.
    pub state: &'static str,
    /// Its process id; `None` when it does not live.
    pub pid: Option<u32>,
    /// Its configured rate; `None` for a process without a rate.
    pub rate_hz: Option<f64>,
    /// Ticks done, over all restarts.
    pub ticks: u64,
    /// Ticks completed after their deadline.
    pub late: u64,
    /// Ticks of the grid skipped.
    pub skipped: u64,
    /// Its restarts.
    pub restarts: u32,
    /// The real-time priority in force; 0 for none.
    pub priority: u32,
    /// Resident memory at its peak, MB of 10^6 bytes.
    pub resident_mb: f64,
    /// Ticks in which a part took longer than its budget, by part.
    pub overruns: Vec<(&'static str, u64)>,
}

impl View {
    /// The view of the supervisor.
    pub fn from_inside(config: &Config, tally: &Tally, set: &ProcessSet) -> Self {
        let processes = set.members().iter().map(|member| {
            let process = member.row().process;
            let said = tally.process(process).and_then(ProcessTally::newest);
            let state = match member.phase() {
                Phase::Waiting => "waiting",
                Phase::Starting { .. } => HealthState::Starting.word(),
                Phase::Up { .. } => said
                    .and_then(|health| HealthState::from_code(health.state))
                    .map_or("running", HealthState::word),
                Phase::Resting { .. } => "restarting",
                Phase::Dead { .. } | Phase::Gone => "ended",
            };
            ProcessView {
                restarts: member.restarts(),
                ..ProcessView::of(process, state, member.pid(), config, tally)
            }
        });
        Self::of(config, tally, processes.collect())
    }

    /// The view of a command that has listened for a while: a process without a message is
    /// silent. The restarts are those that the supervisor has written down.
    pub fn from_outside(config: &Config, tally: &Tally, restarts: &BTreeMap<String, u32>) -> Self {
        let processes = rows(config).map(|row| {
            let said = tally.process(row.process).and_then(ProcessTally::newest);
            let state = said
                .and_then(|health| HealthState::from_code(health.state))
                .map_or("silent", HealthState::word);
            let pid = said.map(|health| health.header.producer);
            ProcessView {
                restarts: restarts.get(row.process.word()).copied().unwrap_or(0),
                ..ProcessView::of(row.process, state, pid, config, tally)
            }
        });
        Self::of(config, tally, processes.collect())
    }

    fn of(config: &Config, tally: &Tally, processes: Vec<ProcessView>) -> Self {
        Self {
            run: config.run.name.clone(),
            clock: clock_word(config),
            rate_hz: config.run.rate_hz,
            episode: tally.progress.map(|progress| EpisodeView {
                number: progress.header.episode.saturating_add(1),
                of: config.run.episodes,
                seed: progress.seed,
                completion: progress.completion,
                speed_mps: progress.speed_mps,
                braked: progress.braked,
            }),
            driver: tally
                .steps
                .newest
                .map(|(driver, reason)| (driver.word(), reason.word())),
            is_person: config.gate.mode == GateMode::Human
                && tally
                    .steps
                    .newest
                    .is_some_and(|(_, reason)| reason == Reason::Takeover),
            is_unled: tally.is_unled,
            world_refusals: world_refusals(tally),
            policy: tally.policy.as_ref().and_then(PolicyView::of),
            outcomes: Outcome::ALL
                .iter()
                .filter(|outcome| **outcome != Outcome::Driving)
                .map(|outcome| (outcome.word(), tally.outcome_count(*outcome)))
                .collect(),
            processes,
            help: None,
        }
    }
}

/// Messages that the world refused, by reason.
fn world_refusals(tally: &Tally) -> BTreeMap<&'static str, u64> {
    let totals = tally.process(Process::World).map(ProcessTally::totals);
    let refused = totals.unwrap_or_default().refused;
    let occurred = refused.occurred();
    occurred.map(|(kind, count)| (kind.word(), count)).collect()
}

impl ProcessView {
    fn of(
        process: Process,
        state: &'static str,
        pid: Option<u32>,
        config: &Config,
        tally: &Tally,
    ) -> Self {
        let counted = tally.process(process);
        let totals = counted.map(ProcessTally::totals).unwrap_or_default();
        Self {
            process: process.word(),
            state,
            pid,
            rate_hz: config.rate_hz(process),
            ticks: totals.ticks,
            late: totals.late,
            skipped: totals.skipped,
            restarts: 0,
            priority: counted
                .and_then(ProcessTally::newest)
                .map_or(0, |health| health.priority_got),
            resident_mb: counted.map_or(0.0, |counted| counted.memory().resident as f64 / 1e6),
            overruns: totals
                .overruns()
                .map(|(part, count)| (part.word(), count))
                .collect(),
        }
    }
}
