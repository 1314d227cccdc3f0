//! What a run's messages add up to, over all restarts.

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

/// Everything counted so far.
#[derive(Debug, Default)]
pub struct Tally {
    /// Steps: who drove, and why.
    pub steps: StepTally,
    /// Finished episodes.
    pub episodes: Episodes,
    /// How the current episode goes.
    pub progress: Option<Progress>,
    /// The world braked since its word before for want of a command.
    pub is_unled: bool,
    /// What the controller says of its weights.
    pub policy: Option<PolicyStatus>,
    /// Greatest age of a command that the car obeyed, ns.
    pub oldest_obeyed_ns: u64,
    /// Messages whose content made no sense.
    pub refused: u64,
    /// When the supervisor was started; `None` for an onlooker.
    pub started: Option<Instant>,
    processes: BTreeMap<u32, ProcessTally>,
}

impl Tally {
    /// Of a run whose supervisor was started then.
    pub fn begun(started: Instant) -> Self {
        Self {
            started: Some(started),
            ..Self::default()
        }
    }

    /// Takes a health in; its state, or `None` when its content is refused.
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

    /// Takes a timing in: the last of each producer counts, since each holds
    /// everything since its start.
    pub fn count_timing(&mut self, process: Process, timing: Timing) {
        let tally = self.processes.entry(process.code()).or_default();
        tally.count_timing(timing);
    }

    /// Takes in what the kernel says of a process's memory: the most counts.
    pub fn count_memory(&mut self, process: Process, memory: Memory) {
        let tally = self.processes.entry(process.code()).or_default();
        tally.count_memory(memory);
    }

    /// Takes in what the kernel says of a process's threads: the last look counts.
    pub fn count_threads(&mut self, process: Process, pid: u32) {
        if let Some(tally) = self.processes.get_mut(&process.code()) {
            tally.count_threads(pid);
        }
    }

    /// Takes the world's word on the episode in.
    pub fn count_progress(&mut self, progress: Progress) {
        match progress.check() {
            Ok(()) => {
                self.oldest_obeyed_ns = self.oldest_obeyed_ns.max(progress.oldest_obeyed_ns);
                let before = self.progress.replace(progress);
                self.is_unled = before.is_some_and(|before| progress.braked > before.braked);
            }
            Err(_) => self.refused += 1,
        }
    }

    /// Takes a finished episode in.
    pub fn count_episode(&mut self, episode: Episode) {
        match episode.check() {
            Ok(()) => self.episodes.insert(episode),
            Err(_) => self.refused += 1,
        }
    }

    /// Takes the controller's word on its weights in.
    pub fn count_policy(&mut self, status: PolicyStatus) {
        match status.check() {
            Ok(()) => self.policy = Some(status),
            Err(_) => self.refused += 1,
        }
    }

    /// Takes a step in.
    pub fn count_step(&mut self, step: &Step) {
        // What a controller does after the world's last tick drives nothing. Both
        // instants are on the run's clock.
        let taken = step.header.taken();
        if self.steps.is_closed || self.steps.end.is_some_and(|end| taken >= end) {
            return;
        }
        if step.command.check().is_err() {
            self.refused += 1;
        }
        self.steps.count(step);
    }

    /// The drive is over: steps that still come are not counted.
    pub fn close_steps(&mut self) {
        self.steps.is_closed = true;
    }

    /// The episode that a restarted world begins with: those before are done.
    pub fn next_episode(&self) -> u32 {
        self.episodes.next()
    }

    /// Where a restarted world goes on.
    pub fn resume(&self) -> Resume {
        let world = self.process(Process::World);
        Resume {
            episode: self.next_episode(),
            driven_ns: world.map_or(0, |world| world.totals().elapsed_ns),
        }
    }

    /// How many episodes ended so.
    pub fn outcome_count(&self, outcome: Outcome) -> usize {
        self.episodes.totals().with(outcome)
    }

    /// One process's counts; `None` when it never said anything.
    pub fn process(&self, process: Process) -> Option<&ProcessTally> {
        self.processes.get(&process.code())
    }

    /// Processes that the run did not start and that a process of it heard in the place
    /// of another.
    pub fn foreigners(&self) -> impl Iterator<Item = Foreigner> + '_ {
        let said = self.processes.values().filter_map(ProcessTally::newest);
        said.filter(|health| health.foreign_pid > 0)
            .filter_map(|health| {
                let place = Process::from_code(health.foreign_as)?;
                let pid = health.foreign_pid;
                Some(Foreigner { pid, place })
            })
    }

    /// A process asked for real-time priority and did not get it.
    pub fn is_priority_refused(&self, process: Process) -> bool {
        self.process(process)
            .and_then(ProcessTally::newest)
            .is_some_and(|health| health.priority == Grant::Refused.code())
    }
}
