//! The sums over a run's messages, over all restarts.

use std::collections::BTreeMap;

use shm_config::message::{
    Episode, Grant, Health, HealthState, Outcome, PolicyStatus, Progress, Step, Timing,
};
use shm_config::services::Process;
use shm_config::wire::Foreigner;
use shm_config::{Instant, Message};

use crate::machine::memory::Memory;
use crate::set::launch::Resume;
use crate::telemetry::episodes::Episodes;
use crate::telemetry::process_tally::ProcessTally;
use crate::telemetry::step_tally::StepTally;

/// The sums so far.
#[derive(Debug, Default)]
pub struct Tally {
    /// Steps by driver and reason.
    pub steps: StepTally,
    /// Finished episodes.
    pub episodes: Episodes,
    /// The progress of the current episode.
    pub progress: Option<Progress>,
    /// The world braked since its previous progress message because no recent command existed.
    pub is_unled: bool,
    /// Progress messages of the world.
    pub progress_count: u64,
    /// The controller's status of its weights.
    pub policy: Option<PolicyStatus>,
    /// Maximum age of an applied command, ns.
    pub command_age_max_ns: u64,
    /// Messages with inadmissible content.
    pub refused: u64,
    /// When the supervisor was started; `None` for an observing command.
    pub started: Option<Instant>,
    processes: BTreeMap<u32, ProcessTally>,
}

impl Tally {
    /// The tally of a run whose supervisor was started at this instant.
    pub fn begun(started: Instant) -> Self {
        Self {
            started: Some(started),
            ..Self::default()
        }
    }

    /// Adds a health message; returns its state, or `None` when its content is refused.
    pub fn count_health(&mut self, process: Process, health: &Health) -> Option<HealthState> {
        health.check().ok()?;
        let tally = self.processes.entry(process.code()).or_default();
        tally.count_life(health);
        let state = HealthState::from_code(health.state);
        if process == Process::World && state == Some(HealthState::Finished) {
            self.steps.end = Some(Instant(health.next_scheduled_ns));
        }
        state
    }

    /// Adds a timing message of a process.
    pub fn count_timing(&mut self, process: Process, timing: Timing) {
        let tally = self.processes.entry(process.code()).or_default();
        tally.count_timing(timing);
    }

    /// Adds the memory of a process as the kernel reports it.
    pub fn count_memory(&mut self, process: Process, memory: Memory) {
        let tally = self.processes.entry(process.code()).or_default();
        tally.count_memory(memory);
    }

    /// Reads the threads of a process from the kernel; the newest reading is kept.
    pub fn count_threads(&mut self, process: Process, pid: u32) {
        if let Some(tally) = self.processes.get_mut(&process.code()) {
            tally.count_threads(pid);
        }
    }

    /// Adds the world's progress.
    pub fn count_progress(&mut self, progress: Progress) {
        match progress.check() {
            Ok(()) => {
                self.command_age_max_ns = self.command_age_max_ns.max(progress.command_age_max_ns);
                self.progress_count += 1;
                let before = self.progress.replace(progress);
                self.is_unled = before.is_some_and(|before| progress.braked > before.braked);
            }
            Err(_) => self.refused += 1,
        }
    }

    /// Adds a finished episode.
    pub fn count_episode(&mut self, episode: Episode) {
        match episode.check() {
            Ok(()) => self.episodes.insert(episode),
            Err(_) => self.refused += 1,
        }
    }

    /// Adds the controller's status of its weights.
    pub fn count_policy(&mut self, status: PolicyStatus) {
        match status.check() {
            Ok(()) => self.policy = Some(status),
            Err(_) => self.refused += 1,
        }
    }

    /// Adds a step.
    pub fn count_step(&mut self, step: &Step) {
        // Steps after the world's last tick move no car. Both instants are on the run's
        // clock.
        let taken = step.header.taken();
        if self.steps.is_closed || self.steps.end.is_some_and(|end| taken >= end) {
            return;
        }
        if step.command.check().is_err() {
            self.refused += 1;
        }
        self.steps.count(step);
    }

    /// The run is finished: later steps are not counted.
    pub fn close_steps(&mut self) {
        self.steps.is_closed = true;
    }

    /// The first episode that a restarted world drives.
    pub fn next_episode(&self) -> u32 {
        self.episodes.next()
    }

    /// Where a restarted world continues.
    pub fn resume(&self) -> Resume {
        let world = self.process(Process::World);
        Resume {
            episode: self.next_episode(),
            driven_ns: world.map_or(0, |world| world.totals().elapsed_ns),
        }
    }

    /// Episodes with this outcome.
    pub fn outcome_count(&self, outcome: Outcome) -> usize {
        self.episodes.totals().with(outcome)
    }

    /// The tally of one process; `None` before its first message.
    pub fn process(&self, process: Process) -> Option<&ProcessTally> {
        self.processes.get(&process.code())
    }

    /// Foreign processes whose messages a process of the run has refused.
    pub fn foreigners(&self) -> impl Iterator<Item = Foreigner> + '_ {
        let said = self.processes.values().filter_map(ProcessTally::newest);
        said.filter(|health| health.foreign_pid > 0)
            .filter_map(|health| {
                let place = Process::from_code(health.foreign_as)?;
                let pid = health.foreign_pid;
                Some(Foreigner { pid, place })
            })
    }

    /// Whether a process was refused the real-time priority that it asked for.
    pub fn is_priority_refused(&self, process: Process) -> bool {
        self.process(process)
            .and_then(ProcessTally::newest)
            .is_some_and(|health| health.priority == Grant::Refused.code())
    }
}
