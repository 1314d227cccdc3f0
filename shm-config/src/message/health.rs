use super::{Header, Message, Refusal, Refusals, header_accessors, known};
use crate::services::Process;

crate::word_list! {
    /// The state of a process.
    pub enum HealthState {
        /// Setting up.
        Starting = 0 "starting",
        /// Set up, waiting for its first tick.
        Ready = 1 "ready",
        /// Ticking.
        Running = 2 "running",
        /// Asked to stop, bringing the car to rest.
        Stopping = 3 "stopping",
        /// Its work is done.
        Finished = 4 "finished",
    }
}

crate::word_list! {
    /// The result of a request for a real-time privilege.
    pub enum Grant {
        /// Not asked for.
        Unasked = 0 "not asked",
        /// Asked for and granted.
        Granted = 1 "granted",
        /// Asked for and refused: the process runs without it.
        Refused = 2 "refused",
    }
}

crate::word_list! {
    /// How a thread is scheduled.
    pub enum Scheduling {
        /// The kernel's fair share.
        Ordinary = 0 "ordinary",
        /// `SCHED_FIFO`: before all threads of lower priority.
        Fifo = 1 "fifo",
    }
}

crate::word_list! {
    /// The parts of a tick, each with its own budget (`deadlines.*`).
    pub enum Part {
        /// The controller waits for the plan of its observation.
        Wait = 0 "wait",
        /// The planner checks its observation.
        Admit = 1 "admit",
        /// The planner prepares: grid, course, predictions.
        Grid = 2 "grid",
        /// The planner searches or optimises.
        Search = 3 "search",
        /// The controller decides: expert, policy, verdict, choice.
        Decide = 4 "decide",
        /// Messages are published.
        Send = 5 "send",
        /// The world applies a command and moves.
        Move = 6 "move",
        /// The world computes its observation.
        Observe = 7 "observe",
    }
}

/// Parts of a tick, of all processes.
pub const PARTS: usize = Part::ALL.len();

const _: () = assert!(PARTS == 8, "as the message declares");

crate::message! {
    /// The health of a process, as it reports it. A missing message is a sign too.
    #[derive(Default)]
    pub struct Health: 256 bytes, nested [Header] {
        /// The last tick, and when the message was made.
        pub header: Header,
        /// Ticks done since the process started.
        pub ticks: u64,
        /// Ticks of the grid skipped.
        pub skipped: u64,
        /// Ticks completed after their deadline.
        pub late: u64,
        /// Messages refused by a check, by [`RefusalKind`](super::RefusalKind).
        pub refused: [u64; 6],
        /// Messages lost on queues it reads.
        pub lost: u64,
        /// When its first tick was due, ns on the run's clock.
        pub first_scheduled_ns: u64,
        /// When its next tick is due, ns on the run's clock.
        pub next_scheduled_ns: u64,
        /// Page faults of the tick's thread that needed no disk, since it was ready.
        pub minor_faults: u64,
        /// Page faults of the tick's thread that waited for the disk.
        pub major_faults: u64,
        /// Times that the kernel took the processor away from the tick's thread.
        pub involuntary_switches: u64,
        /// Ticks in which a part took longer than its budget, by [`Part`].
        pub overruns: [u64; 8],
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
        /// A [`Scheduling`]: the one asked for.
        pub scheduling_asked: u32,
        /// A [`Scheduling`]: the one in force.
        pub scheduling_got: u32,
        /// The last process that sent messages of a service without being started for
        /// it; 0 for none.
        pub foreign_pid: u32,
        /// The [`Process`] in whose place it sent.
        pub foreign_as: u32,
    }
}

impl Health {
    /// Messages refused by a check, by reason.
    pub fn refusals(&self) -> Refusals {
        Refusals {
            counts: self.refused,
        }
    }
}

impl Message for Health {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        known("state", self.state, HealthState::from_code)?;
        known("priority", self.priority, Grant::from_code)?;
        known("core", self.core, Grant::from_code)?;
        known("memory", self.memory, Grant::from_code)?;
        known(
            "scheduling_asked",
            self.scheduling_asked,
            Scheduling::from_code,
        )?;
        known("scheduling_got", self.scheduling_got, Scheduling::from_code)?;
        known("foreign_as", self.foreign_as, Process::from_code)
    }
}
