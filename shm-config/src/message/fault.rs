use super::{Header, Message, Refusal, header_accessors, known};
use crate::services::Process;

crate::word_list! {
    /// The failure of a process that gets an order to fail.
    pub enum FaultKind {
        /// Its loop waits for ever; the process lives.
        Hang = 0 "hang",
        /// Its loop pauses for a while.
        Slow = 1 "slow",
        /// It panics.
        Panic = 2 "panic",
        /// The allocator returns no memory.
        Allocation = 3 "allocation",
        /// Its loop runs without end, and processes of lower priority do not get its
        /// core.
        Spin = 4 "spin",
    }
}

crate::message! {
    /// An order to fail, for fault campaigns. Processes read it only if the
    /// configuration has `run.faults`.
    #[derive(Default)]
    pub struct Fault: 48 bytes, nested [Header] {
        /// When it was ordered.
        pub header: Header,
        /// Duration, ns; for a slow loop only.
        pub duration_ns: u64,
        /// The [`Process`] that shall fail.
        pub target: u32,
        /// A [`FaultKind`].
        pub kind: u32,
    }
}

impl Message for Fault {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        known("target", self.target, Process::from_code)?;
        known("kind", self.kind, FaultKind::from_code)
    }
}
