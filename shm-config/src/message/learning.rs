use super::{Header, Message, Refusal, header_accessors};

crate::message! {
    /// The progress of the learner: in lockstep, the controller waits for it at the end
    /// of every block.
    #[derive(Default)]
    pub struct Learning: 56 bytes, nested [Header] {
        /// Its tick is that of the last step considered.
        pub header: Header,
        /// Steps driven as the learner counts them: read and missed.
        pub steps: u64,
        /// Version of the weights last published; 0 for none.
        pub version: u64,
        /// Steps from one update to the next: `learner.block_steps`.
        pub block_steps: u64,
    }
}

impl Message for Learning {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        Ok(())
    }
}
