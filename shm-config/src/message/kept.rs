use super::{Header, Message, Refusal, header_accessors};

crate::message! {
    /// How far the recorder has read the steps.
    #[derive(Default)]
    pub struct Kept: 40 bytes, nested [Header] {
        /// The tick of the newest step that it has read; 0 before the first.
        pub header: Header,
        /// Steps that it has read.
        pub steps: u64,
    }
}

impl Kept {
    /// The tick of the newest step that the recorder has read; `None` before the first.
    pub fn step(&self) -> Option<u64> {
        (self.steps > 0).then_some(self.header.tick)
    }
}

impl Message for Kept {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        Ok(())
    }
}
