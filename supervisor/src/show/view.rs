//! How a run does right now, as text. One view serves the live block, the plain
//! lines and `./vlaps status`.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Serialize;
use shm_config::config::Config;
use shm_config::message::{HealthState, Outcome, PolicyStatus, Reason};
use shm_config::services::Process;

use crate::set::member::Phase;
use crate::set::process_set::ProcessSet;
use crate::set::table::rows;
use crate::show::summary::clock_word;
use crate::telemetry::tally::{ProcessTally, Tally};

/// How a run does right now.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct View {
    /// The run's name.
    pub run: String,
    /// The run's clock: real time or lockstep.
    pub clock: &'static str,
    /// Ticks of the run per second asked for: the controller's.
    pub rate_hz: f64,
    /// The current episode; `None` before the first tick.
    pub episode: Option<EpisodeView>,
    /// Who drives, and why; `None` before the first step.
    pub driver: Option<(&'static str, &'static str)>,
    /// The world has no command to obey, and brakes.
    pub is_unled: bool,
    /// The policy's weights; `None` when none were ever offered.
    pub policy: Option<PolicyView>,
    /// Finished episodes by outcome.
    pub outcomes: Vec<(&'static str, usize)>,
    /// Each process.
    pub processes: Vec<ProcessView>,
    /// What the keys do, for the person at them.
    #[serde(skip)]
    pub help: Option<String>,
}

/// The policy's weights.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PolicyView {
    /// Version in charge; 0 for none.
    pub version: u64,
    /// First 8 bytes of its SHA-256, hex.
    pub hash: String,
    /// Version last offered.
    pub offered_version: u64,
    /// What became of it.
    pub state: &'static str,
    /// Why it was refused or rolled back; empty else.
    pub reason: String,
}

/// The current episode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EpisodeView {
    /// Which one, from 1.
    pub number: u32,
    /// Of how many; 0 for no end.
    pub of: u32,
    /// Its seed.
    pub seed: u64,
    /// Share of the route driven, [0, 1].
    pub completion: f64,
    /// Speed, m/s.
    pub speed_mps: f64,
    /// Ticks of this run on which the world braked for want of a command.
    pub braked: u64,
}

/// One process.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProcessView {
    /// Its name.
    pub process: &'static str,
    /// What it does: its own word, or what the supervisor knows.
    pub state: &'static str,
    /// Its process id; `None` when it does not live.
    pub pid: Option<u32>,
    /// Its own rate asked for; `None` of a process at a pace of its own.
    pub rate_hz: Option<f64>,
    /// Ticks done, over all restarts.
    pub ticks: u64,
    /// Ticks completed after their deadline.
    pub late: u64,
    /// Ticks of the grid skipped.
    pub skipped: u64,
    /// How often it was restarted.
    pub restarts: u32,
    /// The real-time priority in force; 0 for none.
    pub priority: u32,
    /// Resident memory at its peak, MB of 10^6 bytes.
    pub resident_mb: f64,
    /// Ticks in which a part took longer than its budget, by part.
    pub overruns: Vec<(&'static str, u64)>,
}

impl View {
    /// What the supervisor sees.
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

    /// What an onlooker sees who has listened for a while: a process that said
    /// nothing meanwhile counts as silent. How often each was restarted its supervisor
    /// has written down.
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
            is_unled: tally.is_unled,
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

    /// Which run, and which episode.
    pub fn headline(&self) -> String {
        let Self {
            run,
            clock,
            rate_hz,
            ..
        } = self;
        let mut line = format!("{run}: {clock}, {rate_hz} Hz");
        if let Some(episode) = &self.episode {
            // Writing to a string cannot fail.
            let _ = write!(line, "; episode {}", episode.number);
            if episode.of > 0 {
                let _ = write!(line, " of {}", episode.of);
            }
            let _ = write!(line, ", seed {}", episode.seed);
        }
        line
    }

    /// Who drives, why, and how fast.
    pub fn drive_line(&self) -> String {
        let speed_mps = self.episode.map_or(0.0, |episode| episode.speed_mps);
        match self.driver {
            _ if self.is_unled => {
                format!("nobody drives: the car brakes for want of a command, {speed_mps:.1} m/s")
            }
            Some((driver, reason)) => {
                let policy = self.policy.as_ref();
                let policy = policy.map_or(String::new(), |policy| format!("; {policy}"));
                let takes_over = reason == Reason::Takeover.word();
                let who = match (takes_over, &self.help) {
                    (true, Some(_)) => "you drive".into(),
                    (true, None) => "a person drives".into(),
                    (false, _) => format!("{driver} drives"),
                };
                format!("{who} ({reason}), {speed_mps:.1} m/s{policy}")
            }
            None => "nobody drives".into(),
        }
    }

    /// The processes as a table, one line each.
    pub fn table(&self) -> String {
        let mut text = String::from(
            "  process    state          pid    Hz    ticks  late skipped restarts prio    MB",
        );
        for row in &self.processes {
            let pid = row.pid.map_or("-".into(), |pid| pid.to_string());
            let rate = row
                .rate_hz
                .map_or("-".into(), |rate_hz| rate_hz.to_string());
            let _ = write!(
                text,
                "\n  {:<10} {:<10} {pid:>7} {rate:>5} {:>8} {:>5} {:>7} {:>8} {:>4} {:>5.1}",
                row.process,
                row.state,
                row.ticks,
                row.late,
                row.skipped,
                row.restarts,
                row.priority,
                row.resident_mb
            );
            let slow: Vec<_> = row
                .overruns
                .iter()
                .map(|(part, count)| format!("{part} {count}"))
                .collect();
            if !slow.is_empty() {
                let _ = write!(text, "\n             over budget: {}", slow.join(", "));
            }
        }
        text
    }

    /// Finished episodes by outcome, such as `arrived 2, out_of_road 1`.
    pub fn outcome_line(&self) -> String {
        let some: Vec<_> = self
            .outcomes
            .iter()
            .filter(|(_, count)| *count > 0)
            .map(|(outcome, count)| format!("{outcome} {count}"))
            .collect();
        match some.is_empty() {
            true => "no episode finished yet".into(),
            false => some.join(", "),
        }
    }

    /// Everything in one line, for output that is not a terminal.
    pub fn plain_line(&self) -> String {
        let completion = self
            .episode
            .map_or(0.0, |episode| episode.completion * 100.0);
        let sum = |field: fn(&ProcessView) -> u64| self.processes.iter().map(field).sum::<u64>();
        let world = self
            .processes
            .iter()
            .find(|row| row.process == Process::World.word());
        format!(
            "{}; {}; {completion:.0} %; {}; ticks {}, skipped {}, late {}, restarts {}",
            self.headline(),
            self.drive_line(),
            self.outcome_line(),
            world.map_or(0, |world| world.ticks),
            world.map_or(0, |world| world.skipped),
            sum(|row| row.late),
            sum(|row| u64::from(row.restarts)),
        )
    }
}

impl PolicyView {
    /// What the controller says; `None` when it was never offered anything.
    pub fn of(status: &PolicyStatus) -> Option<Self> {
        (status.offered_version > 0).then(|| Self {
            version: status.version,
            hash: format!("{:016x}", status.hash),
            offered_version: status.offered_version,
            state: status.state().word(),
            reason: status.refusal().into_owned(),
        })
    }
}

impl std::fmt::Display for PolicyView {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.version {
            0 => write!(f, "no weights in charge")?,
            version => write!(f, "weights {version} ({})", &self.hash[..8])?,
        }
        match (self.offered_version == self.version, self.reason.as_str()) {
            (true, _) => Ok(()),
            (false, "") => write!(f, ", {} {}", self.offered_version, self.state),
            (false, reason) => write!(f, ", {} {}: {reason}", self.offered_version, self.state),
        }
    }
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
