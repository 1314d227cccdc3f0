use shm_config::Instant;
use shm_config::message::{Health, HealthState, LateTick, PARTS, Part, Timing};
use shm_config::services::{health, timing};
use shm_config::wire::{Publisher, Wire, WireError};

use crate::fault::FaultyPort;
use crate::{Member, Privileges, Usage};

/// How often a process publishes its health, ns on the machine's clock.
const HEALTH_NS: u64 = 50_000_000;
/// How often it publishes its histograms, ns on the machine's clock.
const TIMING_NS: u64 = 500_000_000;

/// When a tick happened, on the machine's clock.
#[derive(Clone, Copy, Debug)]
pub struct Tick {
    /// The instant at which it was to begin.
    pub due: Instant,
    /// When the event that released it happened; `None` if the process does not know.
    pub released: Option<Instant>,
    /// When it began.
    pub begun: Instant,
    /// When it was done.
    pub done: Instant,
}

/// Instants of a process's grid at which it began no tick.
#[derive(Clone, Copy, Debug)]
pub struct Skipped {
    /// The newest of them.
    pub newest: Instant,
    /// Time from one to the next, ns.
    pub period_ns: u64,
    /// How many.
    pub count: u64,
}

/// How a tick compares with its deadline.
#[derive(Clone, Copy, Debug)]
pub struct Deadline {
    /// The number of the tick in the run.
    pub tick: u64,
    /// When it had to be done.
    pub deadline: Instant,
    /// When it was done.
    pub done: Instant,
    /// Ticks skipped just before it, each one period earlier; they end with it.
    pub skipped: u64,
    /// Time from tick to tick, ns.
    pub period_ns: u64,
}

/// Where a process sends its health.
pub(crate) trait HealthPort {
    /// Publishes it.
    fn publish(&mut self, health: &mut Health);
    /// Connects to new readers and prepares the next message; this allocates.
    fn update_connections(&mut self);
}

impl HealthPort for Publisher<Health> {
    fn publish(&mut self, health: &mut Health) {
        self.send(health);
    }
    fn update_connections(&mut self) {
        Publisher::update_connections(self);
    }
}

/// What a process reports about itself: health, timing, deadlines and budgets.
pub struct Telemetry {
    /// Its state, to be published.
    pub health: Health,
    /// Its durations. Boxed: 80 kB do not belong on a stack.
    pub timing: Box<Timing>,
    health_port: Box<dyn HealthPort>,
    timing_port: Publisher<Timing>,
    health_due: Instant,
    timing_due: Instant,
    /// The usage of the thread at the instant when it was ready.
    usage_before: Usage,
    budgets_ns: [u64; PARTS],
    part_begun: Instant,
    /// The longest part of this tick so far, and its duration, ns.
    longest: (Part, u64),
    /// Ticks no later than this are not among the latest that are kept, ns.
    late_bar_ns: u64,
    /// In lockstep no tick can be late.
    has_deadlines: bool,
}

impl Telemetry {
    /// Opens the ports; the state is `Starting`.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub fn start(member: &Member) -> Result<Self, WireError> {
        let health_port = member.wire.publisher(health(member.process))?;
        let mut telemetry = Self {
            health: Health::default(),
            timing: Box::default(),
            health_port: match member.config.run.faults {
                true => Box::new(FaultyPort::around(health_port, member)?),
                false => Box::new(health_port),
            },
            timing_port: member.wire.publisher(timing(member.process))?,
            health_due: Instant(0),
            timing_due: Instant(0),
            usage_before: Usage::of_this_thread(),
            budgets_ns: member.config.budgets_ns(member.process),
            part_begun: Instant(0),
            longest: (Part::Send, 0),
            late_bar_ns: 0,
            has_deadlines: !member.config.run.is_lockstep(),
        };
        telemetry.set_privileges(&member.privileges);
        Ok(telemetry)
    }

    /// Notes what the kernel granted.
    pub fn set_privileges(&mut self, privileges: &Privileges) {
        self.health.priority = privileges.priority.code();
        self.health.core = privileges.core.code();
        self.health.memory = privileges.memory.code();
        self.health.priority_asked = privileges.priority_asked();
        self.health.priority_got = privileges.priority_got();
        self.health.scheduling_asked = privileges.scheduling_asked().code();
        self.health.scheduling_got = privileges.scheduling.code();
    }

    /// Publishes a new state immediately.
    pub fn enter(&mut self, state: HealthState, now: Instant) {
        if state == HealthState::Ready {
            self.usage_before = Usage::of_this_thread();
        }
        self.health.state = state.code();
        self.health_due = now;
        self.timing_due = now;
        self.heartbeat(now);
    }

    /// Publishes what is due and updates the connections of its ports, which allocates.
    /// Call it between ticks. It never logs or blocks.
    pub fn heartbeat(&mut self, now: Instant) {
        let is_health_due = now >= self.health_due;
        if is_health_due {
            self.count_usage();
            self.health.header.taken_ns = now.0;
            self.health_port.publish(&mut self.health);
            self.health_due = now.after_ns(HEALTH_NS);
            self.health_port.update_connections();
        }
        if now >= self.timing_due {
            self.timing.header.taken_ns = now.0;
            self.timing_port.send(&mut self.timing);
            self.timing_due = now.after_ns(TIMING_NS);
        }
        // A reader of the timing that came since is connected as often as one of the health.
        if is_health_due {
            self.timing_port.update_connections();
        }
    }

    /// Counts the messages that the ports of a membership refused, and names a process
    /// that sends in place of a process of the run. Call it after the ports were read.
    pub fn count_refused(&mut self, wire: &Wire) {
        self.health.refused = wire.refused().counts;
        if let Some(foreigner) = wire.foreigner() {
            self.health.foreign_pid = foreigner.pid;
            self.health.foreign_as = foreigner.place.code();
        }
    }

    /// Call it from the tick's thread, between ticks.
    fn count_usage(&mut self) {
        let usage = Usage::of_this_thread().since(self.usage_before);
        self.health.minor_faults = usage.minor_faults;
        self.health.major_faults = usage.major_faults;
        self.health.involuntary_switches = usage.involuntary_switches;
    }

    /// Begins a tick and its first part.
    pub fn begin(&mut self, now: Instant) {
        self.part_begun = now;
        self.longest = (Part::Send, 0);
    }

    /// Ends a part of the tick and begins the next one. A part that took longer than
    /// its budget is counted.
    pub fn end(&mut self, part: Part, now: Instant) {
        let place = part.code() as usize;
        let took_ns = now.since_ns(self.part_begun);
        self.health.overruns[place] += u64::from(took_ns > self.budgets_ns[place]);
        self.part_begun = now;
        if took_ns > self.longest.1 {
            self.longest = (part, took_ns);
        }
    }

    /// Keeps the tick if it is one of the latest since the start. Other ticks cost one
    /// comparison. Call it after the last part of the tick. In lockstep no tick is
    /// late.
    pub fn note_deadline(&mut self, at: Deadline) {
        if !self.has_deadlines {
            return;
        }
        let first = Instant(at.deadline.0.saturating_sub(at.skipped * at.period_ns));
        let late_ns = at.done.since_ns(first);
        if late_ns > self.late_bar_ns {
            let (part, part_ns) = self.longest;
            self.late_bar_ns = self.timing.keep_late(LateTick {
                tick: at.tick,
                late_ns,
                part_ns,
                skipped: at.skipped,
                part: part.code(),
                reserved: 0,
            });
        }
    }

    /// Counts one tick and records its lateness.
    pub fn count_tick(&mut self, tick: Tick) {
        self.health.ticks += 1;
        self.record_tick(tick);
    }

    /// Records the lateness of a tick.
    pub fn record_tick(&mut self, tick: Tick) {
        let timing = &mut self.timing;
        let lateness_ns = tick.begun.since_ns(tick.due);
        timing.release_lateness.record(lateness_ns);
        if let Some(released) = tick.released {
            timing.wake_up.record(tick.begun.since_ns(released));
        }
        timing.execution.record(tick.done.since_ns(tick.begun));
    }

    /// Records each skipped instant with its full lateness: from the instant until the
    /// process next began a tick. Without this a stall would count once, however many
    /// ticks it caused to be skipped (coordinated omission). The process never saw what
    /// would have released them, so their wake-up counts from their instants too.
    pub fn record_skipped(&mut self, skipped: Skipped, begun: Instant) {
        let newest_ns = begun.since_ns(skipped.newest);
        let (period_ns, count) = (skipped.period_ns, skipped.count);
        let timing = &mut self.timing;
        timing
            .release_lateness
            .record_series(newest_ns, period_ns, count);
        timing.wake_up.record_series(newest_ns, period_ns, count);
    }
}
