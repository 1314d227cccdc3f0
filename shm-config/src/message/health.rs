use super::{Header, Message, Refusal, header_accessors, known};

crate::word_list! {
    /// How far a process is.
    pub enum HealthState {
        /// Setting up.
        Starting = 0 "starting",
        /// Set up, waiting for its first tick.
        Ready = 1 "ready",
        /// Ticking.
        Running = 2 "running",
        /// Asked to stop, bringing the car to rest.
        Stopping = 3 "stopping",
        /// All its work is done.
        Finished = 4 "finished",
    }
}

crate::word_list! {
    /// What became of a request for a real-time right.
    pub enum Grant {
        /// Not asked for.
        Unasked = 0 "not asked",
        /// Asked for and granted.
        Granted = 1 "granted",
        /// Asked for and refused: the process runs without it.
        Refused = 2 "refused",
    }
}

crate::message! {
    /// How a process does, from the process itself. Its absence is a sign too.
    #[derive(Default)]
    pub struct Health: 120 bytes, nested [Header] {
        /// The last tick, and when this was said.
        pub header: Header,
        /// Ticks done since the process started.
        pub ticks: u64,
        /// Ticks of the grid skipped.
        pub skipped: u64,
        /// Ticks completed after their deadline.
        pub late: u64,
        /// Messages refused at the door.
        pub refused: u64,
        /// Messages lost on queues it reads.
        pub lost: u64,
        /// When its first tick was due, ns on the run's clock.
        pub first_scheduled_ns: u64,
        /// When its next tick is due, ns on the run's clock.
        pub next_scheduled_ns: u64,
        /// A [`HealthState`].
        pub state: u32,
        /// A [`Grant`]: real-time scheduling.
        pub priority: u32,
        /// A [`Grant`]: its own core.
        pub core: u32,
        /// A [`Grant`]: memory locked.
        pub memory: u32,
        /// The priority asked for; 0 for none.
        pub priority_asked: u32,
        /// The priority in force; 0 for none.
        pub priority_got: u32,
        /// Not used.
        pub reserved: [u32; 2],
    }
}

crate::message! {
    /// Durations counted in buckets of [`crate::histogram`].
    pub struct Histogram: 11280 bytes {
        /// The largest duration seen, ns, exact.
        pub max_ns: u64,
        /// Durations counted.
        pub count: u64,
        /// Durations by bucket.
        pub buckets: [u32; 2816],
    }
}

crate::message! {
    /// How punctual a process is: full-range histograms since it started.
    #[derive(Default)]
    pub struct Timing: 33872 bytes, nested [Header, Histogram] {
        /// When.
        pub header: Header,
        /// From the scheduled instant to the begin of the tick.
        pub release_lateness: Histogram,
        /// From begin to end of the tick.
        pub execution: Histogram,
        /// From the world's release to the command (controller), else empty.
        pub response: Histogram,
    }
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            max_ns: 0,
            count: 0,
            buckets: [0; 2816],
        }
    }
}

impl Message for Health {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        known("state", self.state, HealthState::from_code)?;
        known("priority", self.priority, Grant::from_code)?;
        known("core", self.core, Grant::from_code)?;
        known("memory", self.memory, Grant::from_code)
    }
}

impl Message for Timing {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        Ok(())
    }
}
