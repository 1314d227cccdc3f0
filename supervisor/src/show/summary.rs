//! The summary of a run.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use serde::Serialize;
use shm_config::config::{Config, GateMode};
use shm_config::message::{Driver, Episode, Grant, Reason};
use shm_config::services::Process;

use crate::cli::output::write_whole;
use crate::machine::idle::IdleBound;
use crate::set::process_set::ProcessSet;
use crate::show::clock::clock_word;
use crate::show::policy_view::PolicyView;
use crate::show::process_row::ProcessRow;
use crate::telemetry::episodes::EpisodeTotals;
use crate::telemetry::judge;
use crate::telemetry::late::{self, LateRow};
use crate::telemetry::process_tally::Totals;
use crate::telemetry::quantiles::Quantiles;
use crate::telemetry::tally::Tally;

/// One object: the keys before the blank line are what scripts rely on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Finished episodes in order, the newest where there are very many.
    pub episodes: Vec<EpisodeRow>,
    /// The sums over all of them.
    pub episode_totals: EpisodeTotals,
    /// The run's ticks that the world published: those of the controller's rate,
    /// however often the world moves in between.
    pub ticks: u64,
    /// Ticks of the grid that the world skipped.
    pub skipped: u64,
    /// From the run's first scheduled tick to the next scheduled one, s on the run's clock.
    pub elapsed_s: f64,
    /// Time from tick to tick of the run, s.
    pub period_s: f64,
    /// SHA-256 over the digests of all episodes' commands, in order; hex.
    /// `None` when no episode was finished.
    pub command_digest: Option<String>,
    /// Share of the steps by driver.
    pub share: Share,
    /// Restarts of all processes.
    pub restarts: u32,
    /// The world's release lateness; left out when it never ticked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub release_lateness_us: Option<Quantiles>,
    /// From the supervisor's start to the controller's first command, s; `None`
    /// when there was none.
    pub first_command_s: Option<f64>,

    /// The run's name.
    pub run: String,
    /// Its clock: real time or lockstep.
    pub clock: &'static str,
    /// How the run ended: finished, stopped, or why it was given up.
    pub ended: String,
    /// Steps read.
    pub steps: u64,
    /// Steps lost before they were read.
    pub lost_steps: u64,
    /// Share of the steps that a human driver drove; they are also counted as the expert's.
    pub person_share: f64,
    /// Steps by driver and reason, such as `expert: {unloaded: 120}`.
    pub reasons: BTreeMap<&'static str, BTreeMap<&'static str, u64>>,
    /// Ticks on which the world braked without a recent command, in finished episodes.
    pub braked: u64,
    /// Maximum age of an applied command, ms.
    pub command_age_max_ms: f64,
    /// The policy's weights at the end; `None` when none were ever offered.
    pub policy: Option<PolicyView>,
    /// The steps of each version of the weights, the oldest first; of a run with many, the
    /// last 1,000.
    pub weights: Vec<WeightsRow>,
    /// The judge's record; `None` without a judge.
    pub judge: Option<shm_config::judged::Judged>,
    /// Why the judge was never asked; left out where it was asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub judge_unasked: Option<&'static str>,
    /// Whether the processors were kept from sleeping: granted, refused or not asked.
    pub cpu_latency: &'static str,
    /// The ticks that were latest, the latest first; at most 20.
    pub late_ticks: Vec<LateRow>,
    /// Each process.
    pub processes: BTreeMap<&'static str, ProcessRow>,
}

/// One version of the weights.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct WeightsRow {
    /// Its number.
    pub version: u64,
    /// First 8 bytes of its SHA-256, hex.
    pub hash: String,
    /// Steps in which it proposed.
    pub proposed: u64,
    /// Steps in which it drove.
    pub drove: u64,
}

/// One finished episode.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeRow {
    /// Its seed.
    pub seed: u64,
    /// How it ended.
    pub outcome: &'static str,
    /// Arrived without contact.
    pub strict: bool,
    /// Share of the route driven.
    pub completion: f64,
    /// Ticks driven.
    pub ticks: u64,
}

/// Share of the steps by driver, each in [0, 1].
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Share {
    /// The hand-made expert.
    pub expert: f64,
    /// The learned policy.
    pub policy: f64,
    /// The brake.
    pub brake: f64,
}

impl EpisodeRow {
    fn of(episode: &Episode) -> Self {
        Self {
            seed: episode.seed,
            outcome: episode.outcome().word(),
            strict: episode.is_strict_success(),
            completion: episode.completion,
            ticks: episode.ticks,
        }
    }
}

impl Summary {
    /// Adds the run up; `ended` is how it ended.
    pub fn of(config: &Config, tally: &Tally, set: &ProcessSet, ended: String) -> Self {
        let processes: BTreeMap<_, _> = set
            .members()
            .iter()
            .map(|member| {
                let process = member.row().process;
                (
                    process.word(),
                    ProcessRow::of(process, member.restarts(), config, tally),
                )
            })
            .collect();
        let world = tally.process(Process::World);
        let totals = world.map_or_else(Totals::default, |world| world.totals());
        let judge = judge::read(config, std::process::id());
        let mut reasons = BTreeMap::<_, BTreeMap<_, _>>::new();
        for (driver, reason, count) in tally.steps.reasons() {
            *reasons
                .entry(driver.word())
                .or_default()
                .entry(reason)
                .or_default() += count;
        }
        let episode_totals = tally.episodes.totals();
        Self {
            episodes: tally.episodes.kept().map(EpisodeRow::of).collect(),
            ticks: totals.ticks,
            skipped: totals.skipped,
            elapsed_s: totals.elapsed_ns as f64 / 1e9,
            period_s: config.run.period_ns() as f64 / 1e9,
            command_digest: tally.episodes.command_digest(),
            share: Share {
                expert: tally.steps.share(Driver::Expert),
                policy: tally.steps.share(Driver::Policy),
                brake: tally.steps.share(Driver::Brake),
            },
            restarts: processes.values().map(|row| row.restarts).sum(),
            release_lateness_us: processes
                .get(Process::World.word())
                .and_then(|world| world.release_lateness_us),
            first_command_s: first_command_s(tally),
            run: config.run.name.clone(),
            clock: clock_word(config),
            ended,
            steps: tally.steps.received,
            lost_steps: tally.steps.lost(),
            person_share: person_share(config, tally),
            reasons,
            braked: episode_totals.braked,
            episode_totals,
            policy: tally.policy.as_ref().and_then(PolicyView::of),
            weights: tally
                .steps
                .weights()
                .map(|(version, hash, counted)| WeightsRow {
                    version,
                    hash: format!("{hash:016x}"),
                    proposed: counted.proposed,
                    drove: counted.drove,
                })
                .collect(),
            command_age_max_ms: tally.command_age_max_ns as f64 / 1e6,
            judge_unasked: judge::unasked(config, tally, judge.as_ref()),
            judge,
            late_ticks: late::most_late(tally),
            cpu_latency: Grant::Unasked.word(),
            processes,
        }
    }

    /// Adds whether the bound on sleeping processors was granted.
    pub fn with_idle(self, bound: &IdleBound) -> Self {
        Self {
            cpu_latency: bound.grant().word(),
            ..self
        }
    }

    /// The object as JSON.
    ///
    /// # Errors
    /// When a number in it has no form in JSON.
    pub fn text(&self) -> io::Result<String> {
        let text = serde_json::to_string_pretty(self).map_err(io::Error::other)?;
        // It may hold untrusted text of a server or of a log.
        Ok(shm_config::text::printable_json(&text).into_owned() + "\n")
    }

    /// Writes the object so that a reader finds the old file or the whole new one.
    ///
    /// # Errors
    /// When the folder is missing or refuses.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        write_whole(path, &self.text()?)
    }
}

/// Share of the steps that a human driver drove, [0, 1]; only this mode has one, in the mode
/// `takeover` the expert takes over.
fn person_share(config: &Config, tally: &Tally) -> f64 {
    if config.gate.mode != GateMode::Human {
        return 0.0;
    }
    let takeovers = tally.steps.reasons();
    let takeovers = takeovers.filter(|(_, reason, _)| *reason == Reason::Takeover.word());
    let driven: u64 = takeovers.map(|(_, _, count)| count).sum();
    driven as f64 / tally.steps.received.max(1) as f64
}

fn first_command_s(tally: &Tally) -> Option<f64> {
    let (started, first) = (tally.started?, tally.steps.first_commanded?);
    Some(first.since_ns(started) as f64 / 1e9)
}
