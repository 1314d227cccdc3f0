//! What a run's messages add up to, over all restarts.

use std::collections::BTreeMap;

use shm_config::message::{
    Driver, Episode, Grant, Health, HealthState, Histogram, Outcome, PARTS, Part, PolicyStatus,
    Progress, Reason, Refusals, Step, Timing,
};
use shm_config::services::Process;
use shm_config::wire::Foreigner;
use shm_config::{Instant, Message};

use crate::machine::memory::Memory;
use crate::machine::threads::{Thread, threads};
use crate::set::launch::Resume;
use crate::telemetry::episodes::Episodes;

/// Timings kept apart, by producer; older ones are merged. A dead process's last
/// timing may come after its successor's first, never after four successors'.
const TIMINGS_APART: usize = 4;

/// Versions of the weights that are kept apart: a run may swap for ever.
pub const WEIGHTS_KEPT: usize = 1000;

/// Lives of a process that are kept apart; older ones are added up, so that a process
/// may be restarted for ever.
const LIVES_APART: usize = 16;

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

/// Steps, and who drove in them.
#[derive(Debug, Default)]
pub struct StepTally {
    /// Steps read.
    pub received: u64,
    /// When the first one was taken, on the run's clock.
    pub begun: Option<Instant>,
    /// When the first command went out, on the machine's clock.
    pub first_commanded: Option<Instant>,
    /// The newest driver and reason.
    pub newest: Option<(Driver, Reason)>,
    counts: BTreeMap<(u32, u32), u64>,
    weights: BTreeMap<(u64, u64), WeightsTally>,
    /// The newest number of each controller, the last ones apart.
    last_sequences: Vec<(u32, u64)>,
    /// Steps of the controllers before them.
    sent_before: u64,
    /// The first instant that the world had no tick for any more.
    end: Option<Instant>,
    is_closed: bool,
}

/// What one version of the weights did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WeightsTally {
    /// Steps in which they proposed.
    pub proposed: u64,
    /// Steps in which they drove.
    pub drove: u64,
}

/// One process over all its restarts.
#[derive(Debug, Default)]
pub struct ProcessTally {
    /// The last word of each life, the newest lives apart.
    lives: Vec<Health>,
    /// What the lives before them add up to, and when the last of them was to tick next.
    past: Totals,
    past_next_ns: u64,
    newest: Option<Health>,
    timings: Vec<(u32, Box<Timing>)>,
    merged: Box<Timing>,
    memory: Memory,
    threads: Vec<Thread>,
}

/// Counts over all restarts of one process.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Totals {
    /// Ticks done.
    pub ticks: u64,
    /// Ticks of the grid skipped.
    pub skipped: u64,
    /// Time from one life's next tick due to the first one due of the life after
    /// it: nobody was there, ns on the run's clock.
    pub absent_ns: u64,
    /// Ticks completed after their deadline.
    pub late: u64,
    /// Messages refused at the door, by reason.
    pub refused: Refusals,
    /// Messages lost on queues.
    pub lost: u64,
    /// Page faults of the tick's thread that needed no disk.
    pub minor_faults: u64,
    /// Page faults of the tick's thread that waited for the disk.
    pub major_faults: u64,
    /// Times that the kernel took the processor away from the tick's thread.
    pub involuntary_switches: u64,
    /// Ticks in which a part took longer than its budget, by [`Part`].
    pub overruns: [u64; PARTS],
    /// From the first tick due to the next one due, ns on the run's clock.
    pub elapsed_ns: u64,
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
        tally.newest = Some(*health);
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
        let pid = timing.header.producer;
        match tally
            .timings
            .iter_mut()
            .find(|(producer, _)| *producer == pid)
        {
            Some((_, last)) => **last = timing,
            None => tally.timings.push((pid, Box::new(timing))),
        }
        if tally.timings.len() > TIMINGS_APART {
            let (_, oldest) = tally.timings.remove(0);
            tally.merged.merge(&oldest);
        }
    }

    /// Takes in what the kernel says of a process's memory: the most counts.
    pub fn count_memory(&mut self, process: Process, memory: Memory) {
        let tally = self.processes.entry(process.code()).or_default();
        tally.memory = tally.memory.max(memory);
    }

    /// Takes in what the kernel says of a process's threads: the last look counts.
    pub fn count_threads(&mut self, process: Process, pid: u32) {
        let Some(tally) = self.processes.get_mut(&process.code()) else {
            return;
        };
        let said = tally.newest.filter(|health| health.header.producer == pid);
        if let Some(health) = said {
            let seen = threads(pid, &health);
            if !seen.is_empty() {
                tally.threads = seen;
            }
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

impl StepTally {
    fn count(&mut self, step: &Step) {
        self.received += 1;
        let header = &step.header;
        self.begun.get_or_insert(header.taken());
        self.first_commanded
            .get_or_insert(Instant(step.timings.commanded_ns));
        self.count_sequence(header.producer, header.sequence);
        let (driver, reason) = (step.driver(), step.reason());
        let reason_code = reason.map_or(u32::MAX, Reason::code);
        *self.counts.entry((driver.code(), reason_code)).or_default() += 1;
        if step.weights_version > 0 {
            let key = (step.weights_version, step.weights_hash);
            let weights = self.weights.entry(key).or_default();
            weights.proposed += 1;
            weights.drove += u64::from(driver == Driver::Policy);
            if self.weights.len() > WEIGHTS_KEPT {
                self.weights.pop_first();
            }
        }
        self.newest = Some((driver, reason.unwrap_or(Reason::Blind)));
    }

    fn count_sequence(&mut self, producer: u32, sequence: u64) {
        let mut known = self.last_sequences.iter_mut();
        match known.find(|(pid, _)| *pid == producer) {
            Some((_, last)) => *last = sequence,
            None => self.last_sequences.push((producer, sequence)),
        }
        if self.last_sequences.len() > LIVES_APART {
            self.sent_before += self.last_sequences.remove(0).1;
        }
    }

    /// Steps that were overwritten before they were read. Every producer counts
    /// its steps from 1, and the reader is there before the first.
    pub fn lost(&self) -> u64 {
        let sent: u64 = self.last_sequences.iter().map(|(_, last)| last).sum();
        (self.sent_before + sent).saturating_sub(self.received)
    }

    /// What each version of the weights did, the oldest first; the last
    /// [`WEIGHTS_KEPT`] of a run that has seen more. With the first 8 bytes of their
    /// SHA-256.
    pub fn weights(&self) -> impl Iterator<Item = (u64, u64, WeightsTally)> + '_ {
        let all = self.weights.iter();
        all.map(|(&(version, hash), &counted)| (version, hash, counted))
    }

    /// Steps driven by one driver, for any reason.
    pub fn driven_by(&self, driver: Driver) -> u64 {
        self.counts
            .iter()
            .filter(|((code, _), _)| *code == driver.code())
            .map(|(_, count)| count)
            .sum()
    }

    /// Share of the steps read that one driver drove, [0, 1]; 0 without steps.
    pub fn share(&self, driver: Driver) -> f64 {
        match self.received {
            0 => 0.0,
            received => self.driven_by(driver) as f64 / received as f64,
        }
    }

    /// Steps by driver and reason, in the order of the two lists.
    pub fn reasons(&self) -> impl Iterator<Item = (Driver, &'static str, u64)> + '_ {
        self.counts.iter().map(|(&(driver, reason), &count)| {
            let driver = Driver::from_code(driver).unwrap_or(Driver::Brake);
            let reason = Reason::from_code(reason).map_or("unknown", Reason::word);
            (driver, reason, count)
        })
    }
}

impl ProcessTally {
    /// The newest health.
    pub fn newest(&self) -> Option<&Health> {
        self.newest.as_ref()
    }

    /// Takes in the last word of a life. Of those long past only the sums are kept.
    fn count_life(&mut self, health: &Health) {
        let pid = health.header.producer;
        match self
            .lives
            .iter_mut()
            .find(|life| life.header.producer == pid)
        {
            Some(life) => *life = *health,
            None => self.lives.push(*health),
        }
        if self.lives.len() > LIVES_APART {
            let oldest = self.lives.remove(0);
            self.past.absent_ns += absence_ns(&mut self.past_next_ns, &oldest);
            self.past.add(&oldest);
        }
    }

    /// Counts over all restarts.
    pub fn totals(&self) -> Totals {
        let (mut totals, mut next_ns) = (self.past, self.past_next_ns);
        for life in &self.lives {
            totals.absent_ns += absence_ns(&mut next_ns, life);
            totals.add(life);
        }
        totals
    }

    /// Histograms over all restarts.
    pub fn timing(&self) -> Box<Timing> {
        let mut all = self.merged.clone();
        for (_, timing) in &self.timings {
            all.merge(timing);
        }
        all
    }

    /// Its threads as they were last seen.
    pub fn threads(&self) -> &[Thread] {
        &self.threads
    }

    /// The most memory it had.
    pub fn memory(&self) -> Memory {
        self.memory
    }
}

/// Time from when the life before was to tick next, which then becomes that of this
/// one, to this one's first tick; 0 where either had none.
fn absence_ns(next_ns: &mut u64, life: &Health) -> u64 {
    if life.first_scheduled_ns == 0 {
        return 0;
    }
    let before_ns = std::mem::replace(next_ns, life.next_scheduled_ns);
    match before_ns {
        0 => 0,
        before_ns => life.first_scheduled_ns.saturating_sub(before_ns),
    }
}

impl Totals {
    fn add(&mut self, health: &Health) {
        self.ticks += health.ticks;
        self.skipped += health.skipped;
        self.late += health.late;
        self.refused.add(&health.refusals());
        self.lost += health.lost;
        self.minor_faults += health.minor_faults;
        self.major_faults += health.major_faults;
        self.involuntary_switches += health.involuntary_switches;
        for (sum, count) in self.overruns.iter_mut().zip(health.overruns) {
            *sum += count;
        }
        self.elapsed_ns += health
            .next_scheduled_ns
            .saturating_sub(health.first_scheduled_ns);
    }

    /// The parts that took longer than their budget, and in how many ticks.
    pub fn overruns(&self) -> impl Iterator<Item = (Part, u64)> + '_ {
        let counts = Part::ALL.iter().map(|part| (*part, part.code() as usize));
        counts
            .map(|(part, place)| (part, self.overruns[place]))
            .filter(|(_, count)| *count > 0)
    }
}

/// A histogram in the four numbers that tables print, microseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Quantiles {
    /// Median, us.
    pub p50: f64,
    /// 99 in 100 lie below, us.
    pub p99: f64,
    /// 999 in 1000 lie below, us.
    pub p999: f64,
    /// The largest, us; exact, nothing is filtered out.
    pub max: f64,
}

impl Quantiles {
    /// Of a histogram; `None` when nothing was counted.
    pub fn of(histogram: &Histogram) -> Option<Self> {
        let us = |ns: u64| ns as f64 / 1e3;
        (histogram.count > 0).then(|| Self {
            p50: us(histogram.quantile_ns(0.5)),
            p99: us(histogram.quantile_ns(0.99)),
            p999: us(histogram.quantile_ns(0.999)),
            max: us(histogram.max_ns),
        })
    }
}
