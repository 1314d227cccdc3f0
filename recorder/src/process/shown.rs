//! The standard topics of a recording, made beside the messages that they show.

use shm_config::config::Config;

use super::ring::Label;
use crate::Channel;
use crate::standard::{Standard, Topic};
use crate::write::Stamp;

/// Makes the standard topics.
pub(super) struct Shown {
    standard: Standard,
    /// The number of the first one's channel; the others follow.
    first: usize,
    sequences: [u64; Topic::ALL.len()],
}

impl Shown {
    /// Adds the topics' channels if the configuration wants them.
    pub(super) fn wanted(
        config: &Config,
        epoch_offset_ns: u64,
        channels: &mut Vec<Channel>,
    ) -> Option<Self> {
        let rate_hz = config.record.standard_hz;
        if rate_hz <= 0.0 {
            return None;
        }
        let first = channels.len();
        channels.extend(Topic::ALL.map(Topic::channel));
        Some(Self {
            standard: Standard::new(config, epoch_offset_ns, rate_hz),
            first,
            sequences: [0; Topic::ALL.len()],
        })
    }

    /// Gives what follows from a message of a service, if it is due.
    pub(super) fn take(
        &mut self,
        (service, label): (&str, Label),
        memory: &[u8],
        put: &mut dyn FnMut(Label, &[u8]),
    ) {
        let (first, sequences) = (self.first, &mut self.sequences);
        let mut numbered = |topic: Topic, cdr: &[u8]| {
            let number = topic as usize;
            sequences[number] += 1;
            let stamp = Stamp {
                sequence: sequences[number],
                ..label.stamp
            };
            let channel = first + number;
            put(Label { channel, stamp }, cdr);
        };
        let of = (service, label.stamp.taken_ns);
        self.standard.message(of, memory, &mut numbered);
    }
}
