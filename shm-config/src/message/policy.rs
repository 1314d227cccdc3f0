use super::{Header, Message, Refusal, fits, header_accessors, known};

/// Bytes of the largest policy file. A 259-256-256-2 net needs 0.53 MB.
pub const WEIGHTS_BYTES_MAX: usize = 8 << 20;

crate::message! {
    /// A whole policy file, offered for adoption.
    pub struct Weights: 8388696 bytes, nested [Header] {
        /// When it was offered.
        pub header: Header,
        /// Grows with every offer of a run.
        pub version: u64,
        /// How many bytes are valid.
        pub byte_count: u64,
        /// SHA-256 of the valid bytes.
        pub sha256: [u8; 32],
        /// The file.
        pub bytes: [u8; 8388608],
        /// Not used; keeps the size a multiple of eight.
        pub end: u64,
    }
}

const _: () = assert!(WEIGHTS_BYTES_MAX == 8_388_608, "as the message declares");

crate::word_list! {
    /// What became of a policy.
    pub enum PolicyState {
        /// None is loaded.
        Empty = 0 "empty",
        /// Adopted, proposes in shadow, may not drive yet.
        Shadow = 1 "shadow",
        /// Adopted and allowed to drive.
        Ready = 2 "ready",
        /// The last offer was refused; the one before stays.
        Refused = 3 "refused",
        /// Adopted, then given up for the one before.
        RolledBack = 4 "rolled_back",
    }
}

crate::message! {
    /// What the controller says of the weights it has and was offered.
    pub struct PolicyStatus: 240 bytes, nested [Header] {
        /// When.
        pub header: Header,
        /// Version in use; 0 for none.
        pub version: u64,
        /// First 8 bytes of its SHA-256; 0 for none.
        pub hash: u64,
        /// Version last offered; 0 for none.
        pub offered_version: u64,
        /// The tick at which the version in use was adopted.
        pub adopted_tick: u64,
        /// A [`PolicyState`].
        pub state: u32,
        /// Valid bytes of `refusal`.
        pub refusal_bytes: u32,
        /// Why the last offer was refused, UTF-8.
        pub refusal: [u8; 168],
    }
}

impl Message for Weights {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        fits("byte_count", self.byte_count, WEIGHTS_BYTES_MAX)
    }
}

impl Message for PolicyStatus {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        known("state", self.state, PolicyState::from_code)?;
        fits(
            "refusal_bytes",
            u64::from(self.refusal_bytes),
            self.refusal.len(),
        )
    }
}
