//! The thread that drains: from shared memory, in order of time, into the ring.

use std::thread::Thread;

use shm_config::Instant;
use shm_config::message::Header;
use shm_config::services::{Process, STEP, TakenFrom, Times};
use shm_config::wire::{PUBLISHERS_MAX, Wire, WireError};

use super::losses::{Losses, Lost};
use super::ring::{Label, RingIn};
use crate::schema::ENCAPSULATION;
use crate::taps::{self, Tap};
use crate::write::Stamp;

/// Bytes of one turn that are sorted by time; a turn with more is passed on in several
/// parts.
const TURN_BYTES: usize = 1 << 20;

/// Tells whether the thread may wait on, in lockstep.
pub(super) type MayWait<'a> = &'a mut dyn FnMut() -> bool;

/// What follows when the ring is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WhenFull {
    /// The message is dropped and counted: nothing waits for a disk.
    Drop,
    /// The thread waits: in lockstep the run's clock can stand still.
    Wait,
}

/// Producers of one service that are remembered: those that may publish at once, and as many
/// short-lived ones, such as `swap`, between two messages of the others.
const PRODUCERS_MAX: usize = 4 * PUBLISHERS_MAX;

/// What the first number that is seen of a producer tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FirstNumber {
    /// It counts from 1: a larger number shows a loss.
    FromOne,
    /// That of the service's first producer tells nothing: it may have published before.
    NotOfFirst,
    /// None tells anything.
    Unknown,
}

/// One service: the numbers that its producers have reached.
struct Source {
    service: String,
    first: FirstNumber,
    /// Process id and last number, the latest producer last.
    producers: Vec<(u32, u64)>,
}

impl Source {
    fn new(tap: &dyn Tap, from_start: bool) -> Self {
        let row = tap.row();
        // The supervisor publishes before it starts any process.
        let is_earlier = row.producers == [Process::Supervisor];
        let first = match (from_start && !is_earlier, row.taken_from) {
            (true, _) => FirstNumber::FromOne,
            (false, TakenFrom::Producer) => FirstNumber::NotOfFirst,
            (false, TakenFrom::Anyone) => FirstNumber::Unknown,
        };
        Self {
            service: tap.channel().service.clone(),
            first,
            producers: Vec::with_capacity(PRODUCERS_MAX),
        }
    }

    /// Notes a message; returns how many were lost between its producer's last one and it.
    /// Several producers of a service publish by turns.
    fn lost(&mut self, header: &Header) -> u64 {
        let (producer, number) = (header.producer, header.sequence);
        let producers = &mut self.producers;
        // Once one is forgotten, an unknown producer may have been known.
        let is_full = producers.len() == PRODUCERS_MAX;
        let known = producers.iter().position(|(known, _)| *known == producer);
        let lost = match (known.map(|at| producers.remove(at).1), self.first) {
            (Some(last), _) => number.saturating_sub(last.saturating_add(1)),
            (None, _) if is_full => 0,
            (None, FirstNumber::Unknown) => 0,
            (None, FirstNumber::NotOfFirst) if producers.is_empty() => 0,
            (None, FirstNumber::NotOfFirst | FirstNumber::FromOne) => number.saturating_sub(1),
        };
        if producers.len() == PRODUCERS_MAX {
            producers.remove(0);
        }
        producers.push((producer, number));
        lost
    }
}

/// One message of a turn: its label, and the place of its bytes.
struct Held {
    label: Label,
    from: usize,
    to: usize,
}

/// Drains all services.
pub(super) struct Drain {
    taps: Vec<Box<dyn Tap>>,
    /// One for each tap.
    sources: Vec<Source>,
    ring: RingIn,
    writer: Thread,
    when_full: WhenFull,
    is_lockstep: bool,
    losses: Losses,
    /// The run's clock, ns: in lockstep that of the newest message.
    now_ns: u64,
    /// The time of the last message passed on, ns.
    last_ns: u64,
    bytes: Vec<u8>,
    held: Vec<Held>,
    /// Messages read.
    pub(super) count: u64,
    /// The tick of the newest step that was read; 0 before the first, from which the
    /// controller knows a recorder that was started again.
    pub(super) step_tick: u64,
    /// Steps that were read.
    pub(super) steps: u64,
}

/// How the drain works.
#[derive(Debug, Clone, Copy)]
pub(super) struct DrainOptions {
    pub(super) when_full: WhenFull,
    pub(super) is_lockstep: bool,
    /// Whether the recorder was there when the run began: then a first message that is not
    /// number 1 shows a loss.
    pub(super) from_start: bool,
}

impl Drain {
    /// Opens all services.
    ///
    /// # Errors
    /// As [`Wire::subscriber`].
    pub(super) fn open(
        wire: &Wire,
        (ring, writer): (RingIn, Thread),
        options: DrainOptions,
    ) -> Result<Self, WireError> {
        let taps = taps::open(wire)?;
        Ok(Self {
            sources: taps
                .iter()
                .map(|tap| Source::new(&**tap, options.from_start))
                .collect(),
            taps,
            ring,
            writer,
            when_full: options.when_full,
            is_lockstep: options.is_lockstep,
            losses: Losses::default(),
            now_ns: 0,
            last_ns: 0,
            bytes: Vec::with_capacity(2 * TURN_BYTES),
            held: Vec::with_capacity(1024),
            count: 0,
            step_tick: 0,
            steps: 0,
        })
    }

    /// Messages lost before the disk.
    pub(super) fn losses(&self) -> &Losses {
        &self.losses
    }

    /// Passes on all messages that wait; returns whether there were any. `now` is the
    /// machine's clock. `may_wait` is called again and again while the ring is full and the
    /// thread waits; once it is false, the messages are dropped.
    pub(super) fn turn(&mut self, now: Instant, may_wait: MayWait<'_>) -> bool {
        if !self.is_lockstep {
            self.now_ns = now.0;
        }
        let before = self.count;
        let step = self
            .sources
            .iter()
            .position(|source| source.service == STEP.name);
        let step = step.unwrap_or(usize::MAX);
        let mut taps = std::mem::take(&mut self.taps);
        for (number, tap) in taps.iter_mut().enumerate() {
            tap.update_connections();
            let times = tap.row().times;
            let mut lost = 0;
            tap.drain(&mut |header, memory, _| {
                lost = u64::saturating_add(lost, self.sources[number].lost(header));
                if number == step {
                    self.step_tick = header.tick;
                    self.steps += 1;
                }
                self.hold((number, times), (header, memory), may_wait);
            });
            if lost > 0 {
                self.losses
                    .add(&self.sources[number].service, Lost::Queue, lost);
            }
        }
        self.taps = taps;
        self.pass_on(may_wait);
        let any = self.count > before;
        if any {
            self.writer.unpark();
        }
        any
    }

    fn hold(
        &mut self,
        (channel, times): (usize, Times),
        (header, memory): (&Header, &[u8]),
        may_wait: MayWait<'_>,
    ) {
        if self.bytes.len() + memory.len() > TURN_BYTES && !self.held.is_empty() {
            self.pass_on(may_wait);
        }
        let taken_ns = header.taken_ns;
        let is_on_run_clock = times == Times::Run;
        if self.is_lockstep && is_on_run_clock {
            self.now_ns = self.now_ns.max(taken_ns);
        }
        // In real time, the roster of the supervisor says no time; in lockstep 0 is tick 0.
        let is_timed = match self.is_lockstep {
            true => is_on_run_clock,
            false => taken_ns > 0,
        };
        let recorded_ns = match is_timed {
            true => taken_ns.min(self.now_ns),
            false => self.now_ns,
        };
        let from = self.bytes.len();
        self.bytes.extend_from_slice(&ENCAPSULATION);
        self.bytes.extend_from_slice(memory);
        let stamp = Stamp {
            recorded_ns,
            taken_ns,
            sequence: header.sequence,
        };
        let to = self.bytes.len();
        self.held.push(Held {
            label: Label { channel, stamp },
            from,
            to,
        });
    }

    /// Puts what was held into the ring, in order of time; services in the order of the
    /// table where times are equal.
    fn pass_on(&mut self, may_wait: MayWait<'_>) {
        self.held.sort_by_key(|held| held.label.stamp.recorded_ns);
        for at in 0..self.held.len() {
            let Held { label, from, to } = &self.held[at];
            let (mut label, from, to) = (*label, *from, *to);
            self.last_ns = self.last_ns.max(label.stamp.recorded_ns);
            label.stamp.recorded_ns = self.last_ns;
            while !self.ring.push(label, &self.bytes[from..to]) {
                self.writer.unpark();
                let is_dropped = self.when_full == WhenFull::Drop || self.ring.is_abandoned();
                if is_dropped || !may_wait() {
                    self.losses
                        .add(&self.sources[label.channel].service, Lost::Ring, 1);
                    break;
                }
                std::thread::park_timeout(super::PATIENCE);
            }
            self.count += 1;
        }
        self.held.clear();
        self.bytes.clear();
        // Offers of weights make it large, once.
        self.bytes.shrink_to(2 * TURN_BYTES);
    }
}

#[cfg(test)]
mod tests;
