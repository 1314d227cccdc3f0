//! The sums over the messages of one process, over all its restarts.

use shm_config::message::{Health, PARTS, Part, Refusals, Timing};

use crate::machine::memory::Memory;
use crate::machine::threads::{Thread, threads};

/// Timings kept apart, by producer; older ones are merged. The last timing of a
/// dead process may arrive after the first of its successor, but not after four successors.
const TIMINGS_APART: usize = 4;

/// Lives of a process, from a start to its end, that are kept apart; older ones are added
/// up, so that a process may be restarted without limit.
pub(crate) const LIVES_APART: usize = 16;

/// One process over all its restarts.
#[derive(Debug, Default)]
pub struct ProcessTally {
    /// The last health of each of the newest lives.
    lives: Vec<Health>,
    /// The sums over older lives, and the next scheduled instant of the last of them.
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
    /// it, ns on the run's clock.
    pub absent_ns: u64,
    /// Ticks completed after their deadline.
    pub late: u64,
    /// Messages refused by a check, by reason.
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

impl ProcessTally {
    /// The newest health.
    pub fn newest(&self) -> Option<&Health> {
        self.newest.as_ref()
    }

    /// Adds the newest health of a life; of older lives only the sums are kept.
    pub(super) fn count_life(&mut self, health: &Health) {
        self.newest = Some(*health);
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

    /// Takes in a timing: the newest of each producer counts, since each holds everything
    /// since its start.
    pub(super) fn count_timing(&mut self, timing: Timing) {
        let pid = timing.header.producer;
        let mut known = self.timings.iter_mut();
        match known.find(|(producer, _)| *producer == pid) {
            Some((_, last)) => **last = timing,
            None => self.timings.push((pid, Box::new(timing))),
        }
        if self.timings.len() > TIMINGS_APART {
            let (_, oldest) = self.timings.remove(0);
            self.merged.merge(&oldest);
        }
    }

    /// Takes in what the kernel reports of its memory: the maximum counts.
    pub(super) fn count_memory(&mut self, memory: Memory) {
        self.memory = self.memory.max(memory);
    }

    /// Reads the threads of process `pid` from the kernel, if its health is known.
    pub(super) fn count_threads(&mut self, pid: u32) {
        let known = self.newest.filter(|health| health.header.producer == pid);
        if let Some(health) = known {
            let found = threads(pid, &health);
            if !found.is_empty() {
                self.threads = found;
            }
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

    /// Its threads at the last reading.
    pub fn threads(&self) -> &[Thread] {
        &self.threads
    }

    /// Its maximum memory.
    pub fn memory(&self) -> Memory {
        self.memory
    }
}

/// The time from the next scheduled instant of the previous life to the first tick of this
/// one; 0 where either had no tick. `next_ns` becomes that of this life.
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
