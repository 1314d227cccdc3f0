use super::{Header, Message, Refusal, fits, header_accessors, known};

/// Bytes of the largest policy file. A 259-256-256-2 net needs 0.53 MB.
pub const WEIGHTS_BYTES_MAX: usize = 8 << 20;

crate::message! {
    /// A whole policy file, offered for adoption.
    pub struct Weights: 8388696 bytes, nested [Header] {
        /// When it was offered.
        pub header: Header,
        /// The version; it grows with every offer of a run.
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
    /// The status of the weights last offered.
    pub enum PolicyState {
        /// None were ever offered, or the last ones are not decided yet.
        Empty = 0 "empty",
        /// Adopted, in shadow mode; may not drive yet.
        Shadow = 1 "shadow",
        /// Adopted and allowed to drive.
        Ready = 2 "ready",
        /// Refused; the weights in use stay.
        Refused = 3 "refused",
        /// Adopted, then rolled back to the previous ones.
        RolledBack = 4 "rolled_back",
    }
}

crate::message! {
    /// The controller's status of the weights that it uses and was offered.
    pub struct PolicyStatus: 336 bytes, nested [Header] {
        /// Its tick is that at which `state` began.
        pub header: Header,
        /// Version in use, which may drive; 0 for none.
        pub version: u64,
        /// First 8 bytes of its SHA-256; 0 for none.
        pub hash: u64,
        /// Version last offered; 0 for none.
        pub offered_version: u64,
        /// First 8 bytes of its SHA-256; 0 for none.
        pub offered_hash: u64,
        /// The tick at which the weights last adopted began to propose, in shadow mode
        /// first.
        pub adopted_tick: u64,
        /// 1 when the version in use could not be written to the run's folder, so that
        /// a restart does not begin with it; else 0.
        pub unkept: u64,
        /// A [`PolicyState`]: that of the weights last offered.
        pub state: u32,
        /// Valid bytes of `refusal`.
        pub refusal_bytes: u32,
        /// Why they were refused or rolled back, UTF-8; empty else.
        pub refusal: [u8; 248],
    }
}

impl PolicyStatus {
    /// The state; an unknown code reads as refused.
    pub fn state(&self) -> PolicyState {
        PolicyState::from_code(self.state).unwrap_or(PolicyState::Refused)
    }

    /// Why the last offer was refused or rolled back.
    #[cfg(feature = "std")]
    pub fn refusal(&self) -> std::borrow::Cow<'_, str> {
        let count = (self.refusal_bytes as usize).min(self.refusal.len());
        String::from_utf8_lossy(&self.refusal[..count])
    }

    /// Stores the reason, cut to the available bytes.
    pub fn set_refusal(&mut self, reason: &str) {
        let mut count = reason.len().min(self.refusal.len());
        while !reason.is_char_boundary(count) {
            count -= 1;
        }
        self.refusal = [0; 248];
        self.refusal[..count].copy_from_slice(&reason.as_bytes()[..count]);
        self.refusal_bytes = count as u32;
    }
}

impl Default for PolicyStatus {
    fn default() -> Self {
        Self {
            header: Header::default(),
            version: 0,
            hash: 0,
            offered_version: 0,
            offered_hash: 0,
            adopted_tick: 0,
            unkept: 0,
            state: PolicyState::Empty.code(),
            refusal_bytes: 0,
            refusal: [0; 248],
        }
    }
}

impl Weights {
    /// The bytes of the file, at most the capacity.
    pub fn file(&self) -> &[u8] {
        &self.bytes[..(self.byte_count as usize).min(WEIGHTS_BYTES_MAX)]
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
