use super::{Header, Message, Refusal, header_accessors};

crate::message! {
    /// How far the recorder has read the steps.
    #[derive(Default)]
    pub struct Kept: 32 bytes, nested [Header] {
        /// The tick of the newest step that it has read.
        pub header: Header,
    }
}

impl Message for Kept {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        Ok(())
    }
}
