use super::{Header, Message, Refusal, header_accessors};
use crate::services::Process;

/// Processes of a run, the supervisor among them.
pub const PROCESSES: usize = Process::ALL.len();

/// Places of a roster: an even number, so that no padding follows.
const PLACES: usize = 8;

const _: () = assert!(
    PROCESSES <= PLACES && PLACES == 8,
    "as the message declares"
);

crate::message! {
    /// The process ids that the run has started; only their messages are taken.
    #[derive(Default)]
    pub struct Roster: 64 bytes, nested [Header] {
        /// When it was last changed.
        pub header: Header,
        /// The process ids, by the code of the [`Process`]; 0 where there is none.
        pub pids: [u32; 8],
    }
}

impl Message for Roster {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        Ok(())
    }
}

impl Roster {
    /// The process id of a process; `None` where there is none.
    pub fn pid(&self, process: Process) -> Option<u32> {
        Some(self.pids[process.code() as usize]).filter(|pid| *pid > 0)
    }

    /// Sets or clears a process id.
    pub fn set(&mut self, process: Process, pid: Option<u32>) {
        self.pids[process.code() as usize] = pid.unwrap_or(0);
    }
}
