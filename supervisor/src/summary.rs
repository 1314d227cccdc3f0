//! What a run amounts to: as JSON and as a table.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use serde::Serialize;
use shm_config::config::Config;
use shm_config::counted;
use shm_config::message::{Driver, Episode, Grant, Outcome};
use shm_config::services::Process;

use crate::episodes::EpisodeTotals;
use crate::idle::IdleBound;
use crate::judged;
use crate::live::PolicyView;
use crate::process_row::ProcessRow;
use crate::set::ProcessSet;
use crate::tally::{Quantiles, Tally, Totals};

/// One object: the keys before the blank line are what scripts rely on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    /// Finished episodes in order, the newest where there are very many.
    pub episodes: Vec<EpisodeRow>,
    /// What all of them add up to.
    pub episode_totals: EpisodeTotals,
    /// The run's ticks that the world published: those of the controller's rate,
    /// however often the world moves in between.
    pub ticks: u64,
    /// Ticks of the grid that the world skipped.
    pub skipped: u64,
    /// From the run's first tick due to the next one due, s on the run's clock.
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
    /// Steps by driver and reason, such as `expert: {unloaded: 120}`.
    pub reasons: BTreeMap<&'static str, BTreeMap<&'static str, u64>>,
    /// Ticks on which the world braked for want of a young command, in finished
    /// episodes.
    pub braked: u64,
    /// Greatest age of a command that the car obeyed, ms.
    pub oldest_obeyed_ms: f64,
    /// The policy's weights at the end; `None` when none were ever offered.
    pub policy: Option<PolicyView>,
    /// What each version of the weights did, the oldest first; of a run with many,
    /// the last 1,000.
    pub weights: Vec<WeightsRow>,
    /// What the judge was asked and said; `None` where nobody judges.
    pub judge: Option<shm_config::judged::Judged>,
    /// Whether the processors were kept from sleeping: granted, refused or not asked.
    pub cpu_latency: &'static str,
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
    /// Arrived without touching anything.
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
    /// Adds everything up; `ended` says how the run ended.
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
            oldest_obeyed_ms: tally.oldest_obeyed_ns as f64 / 1e6,
            judge: judged::read(config, std::process::id()),
            cpu_latency: Grant::Unasked.word(),
            processes,
        }
    }

    /// With what became of the bound on sleeping processors.
    pub fn with_idle(self, bound: &IdleBound) -> Self {
        Self {
            cpu_latency: bound.grant().word(),
            ..self
        }
    }

    /// Writes the object so that a reader finds the old file or the whole new one.
    ///
    /// # Errors
    /// When the folder is missing or refuses.
    pub fn write(&self, path: &Path) -> io::Result<()> {
        let text = serde_json::to_string_pretty(self).map_err(io::Error::other)?;
        // It may hold what a server said, or the last line of a log.
        let text = shm_config::text::printable_json(&text);
        write_whole(path, &format!("{text}\n"))
    }
}

/// Writes a file beside its place, then moves it there. A link is followed, and
/// what is no plain file (a device, a pipe) is written to, never replaced.
///
/// # Errors
/// When the folder is missing or refuses.
pub fn write_whole(path: &Path, text: &str) -> io::Result<()> {
    let target = fs::canonicalize(path);
    let path = target.as_deref().unwrap_or(path);
    if path.metadata().is_ok_and(|metadata| !metadata.is_file()) {
        return fs::write(path, text);
    }
    let mut beside = path.as_os_str().to_owned();
    beside.push(format!(".{}", std::process::id()));
    let beside = PathBuf::from(beside);
    fs::write(&beside, text)
        .and_then(|()| fs::rename(&beside, path))
        .inspect_err(|_| {
            let _ = fs::remove_file(&beside);
        })
}

fn first_command_s(tally: &Tally) -> Option<f64> {
    let (started, first) = (tally.started?, tally.steps.first_commanded?);
    Some(first.since_ns(started) as f64 / 1e9)
}

/// The word of a run's clock that nothing can be late on.
const LOCKSTEP: &str = "lockstep";

/// The word of a run's clock.
pub fn clock_word(config: &Config) -> &'static str {
    match config.run.is_lockstep() {
        true => LOCKSTEP,
        false => "real time",
    }
}

/// Versions of the weights that are listed, the newest first.
const WEIGHTS_SHOWN: usize = 5;
/// Episodes listed one by one at each end of a long run.
const EPISODES_SHOWN: usize = 20;

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "run {}: {}", self.run, self.ended)?;
        self.fmt_episodes(f)?;
        self.fmt_drivers(f)?;
        self.fmt_ticks(f)?;
        self.fmt_processes(f)
    }
}

impl Summary {
    fn fmt_episodes(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.episodes.is_empty() {
            return writeln!(f, "\nno episode was finished");
        }
        writeln!(
            f,
            "\nepisode      seed  outcome      strict  completion   ticks"
        )?;
        let (count, listed) = (self.episode_totals.count, self.episodes.len());
        for (index, row) in self.episodes.iter().enumerate() {
            if index == EPISODES_SHOWN && listed > 2 * EPISODES_SHOWN {
                writeln!(
                    f,
                    "    ... {} more in the JSON ...",
                    listed - 2 * EPISODES_SHOWN
                )?;
            }
            if index >= EPISODES_SHOWN && index + EPISODES_SHOWN < listed {
                continue;
            }
            writeln!(
                f,
                "{:>7}  {:>8}  {:<11}  {:<6}  {:>8.1} %  {:>6}",
                count - listed + index + 1,
                row.seed,
                row.outcome,
                if row.strict { "yes" } else { "no" },
                row.completion * 100.0,
                row.ticks
            )?;
        }
        let with = |outcome: Outcome| self.episode_totals.with(outcome);
        writeln!(
            f,
            "{}: {} arrived ({} without contact), {} out of road, {} max step, {} stopped",
            counted(count, "episode"),
            with(Outcome::Arrived),
            self.episode_totals.strict,
            with(Outcome::OutOfRoad),
            with(Outcome::MaxStep),
            with(Outcome::Stopped),
        )
    }

    fn fmt_drivers(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "\ndrove: expert {:.1} %, policy {:.1} %, brake {:.1} % of {} ({} lost before they were read)",
            self.share.expert * 100.0,
            self.share.policy * 100.0,
            self.share.brake * 100.0,
            counted(self.steps, "step"),
            self.lost_steps
        )?;
        for (driver, reasons) in &self.reasons {
            let list: Vec<_> = reasons
                .iter()
                .map(|(reason, count)| format!("{reason} {count}"))
                .collect();
            writeln!(f, "  {driver}: {}", list.join(", "))?;
        }
        if let Some(policy) = &self.policy {
            writeln!(f, "policy: {policy}")?;
        }
        if self.weights.len() > 1 {
            let rows = self.weights.iter().rev().take(WEIGHTS_SHOWN);
            let rows: Vec<_> = rows
                .map(|row| format!("{} drove {} of {}", row.version, row.drove, row.proposed))
                .collect();
            let more = self.weights.len() - rows.len();
            let more = match more {
                0 => String::new(),
                _ => format!("; {more} more in the JSON"),
            };
            writeln!(f, "  steps by weights: {}{more}", rows.join(", "))?;
        }
        if let Some(judge) = self.judge.as_ref().filter(|judge| judge.questions > 0) {
            writeln!(f, "judge: {judge}")?;
        }
        let digest = self.command_digest.as_deref().unwrap_or("none");
        writeln!(f, "command digest {digest}")
    }

    fn fmt_ticks(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let due = match self.period_s > 0.0 {
            true => (self.elapsed_s / self.period_s).round() as u64,
            false => 0,
        };
        let total = self.ticks + self.skipped;
        let relation = if total == due { "==" } else { "!=" };
        writeln!(
            f,
            "\nworld: ticks {} + skipped {} = {total} {relation} {due} = elapsed {:.3} s / period {} s\n\
             it braked for want of a command on {} of traffic; oldest command obeyed: {:.1} ms",
            self.ticks,
            self.skipped,
            self.elapsed_s,
            self.period_s,
            counted(self.braked, "tick"),
            self.oldest_obeyed_ms
        )?;
        match self.first_command_s {
            Some(first_s) => writeln!(f, "first command {first_s:.2} s after the start"),
            None => Ok(()),
        }
    }

    fn fmt_processes(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // In lockstep nobody asks for any, and nothing can be late.
        if self.clock == LOCKSTEP {
            return self.fmt_restarts(f);
        }
        writeln!(
            f,
            "\nreal-time rights (processors kept from sleeping: {})",
            self.cpu_latency
        )?;
        for (process, row) in &self.processes {
            let rights = &row.realtime;
            writeln!(
                f,
                "  {process:<10}  priority {} (asked {} {}, got {} {}), own core {}, locked memory {}",
                rights.priority,
                rights.scheduling_asked,
                rights.priority_asked,
                rights.scheduling_got,
                rights.priority_got,
                rights.core,
                rights.memory
            )?;
        }
        writeln!(
            f,
            "\nmemory, MB            resident    own  files  messages   faults (disk)  switched out"
        )?;
        for (process, row) in &self.processes {
            let memory = &row.memory_mb;
            writeln!(
                f,
                "  {process:<18}{:>10.1}{:>7.1}{:>7.1}{:>10.1}{:>9} {:>6}  {:>12}",
                row.resident_mb,
                memory.anonymous,
                memory.file,
                memory.shared,
                row.minor_faults,
                format!("({})", row.major_faults),
                row.involuntary_switches
            )?;
        }
        self.fmt_overruns(f)?;
        writeln!(
            f,
            "\nrelease lateness, us       p50         p99       p99.9         max     ticks  skipped  absent    late  restarts"
        )?;
        for (process, row) in &self.processes {
            let [p50, p99, p999, max] = match row.release_lateness_us {
                Some(us) => [us.p50, us.p99, us.p999, us.max].map(|us| format!("{us:.1}")),
                None => [const { "-" }; 4].map(String::from),
            };
            let rate = row
                .rate_hz
                .map_or(String::new(), |rate_hz| format!("{rate_hz} Hz"));
            writeln!(
                f,
                "  {process:<10}{rate:>8}{p50:>10}{p99:>12}{p999:>12}{max:>12}{:>10}{:>9}{:>8}{:>8}{:>10}",
                row.ticks, row.skipped, row.absent, row.late, row.restarts
            )?;
        }
        Ok(())
    }

    /// Which parts of whose ticks took longer than their budget.
    fn fmt_overruns(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (process, row) in &self.processes {
            let parts: Vec<_> = row
                .overruns
                .iter()
                .map(|(part, count)| format!("{part} {count}"))
                .collect();
            if !parts.is_empty() {
                writeln!(f, "\n{process} over budget: {}", parts.join(", "))?;
            }
        }
        Ok(())
    }

    fn fmt_restarts(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let restarted: Vec<_> = self
            .processes
            .iter()
            .filter(|(_, row)| row.restarts > 0)
            .map(|(process, row)| format!("{process} {}", row.restarts))
            .collect();
        match restarted.is_empty() {
            true => Ok(()),
            false => writeln!(f, "\nrestarts: {}", restarted.join(", ")),
        }
    }
}
