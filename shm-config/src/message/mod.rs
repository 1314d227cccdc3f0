//! The messages: `repr(C)`, without padding, of pinned size, checked once on arrival by
//! `admit`.

mod advice;
mod before;
mod camera;
mod command;
mod fault;
mod features;
mod frame;
mod health;
mod kept;
mod learning;
mod newest;
mod observation;
mod plan;
mod policy;
mod progress;
mod refusal;
mod roster;
mod step;
mod takeover;
mod timing;

pub use advice::{Advice, Judge, Preference};
pub use before::{Admission, Before, Entry, Intent, Lateness, PdState, Stage, TransferState};
pub use camera::{Camera, TOP_DOWN_ACROSS_M, TOP_DOWN_AHEAD, TOP_DOWN_HEIGHT_M, View};
pub use command::{Command, Driver, Reason};
pub use fault::{Fault, FaultKind};
pub use features::{
    FEATURE_BEAMS, FEATURES, FEATURES_VERSION, INPUTS_WITH_MOTION, MOTION_AT_REST, MOTION_FEATURES,
    MOTION_LAYOUT, MOTION_SECTORS, OBSERVATION_LAYOUT, STATE_FEATURES, fits_policy, motion_feature,
    motion_sector,
};
pub use frame::{
    FRAME_BYTES_MAX, FRAME_SIDES_PX, Foresight, Frame, FrameRequest, Outlook, PixelFormat,
};
pub use health::{Grant, Health, HealthState, PARTS, Part, Scheduling};
pub use kept::Kept;
pub use learning::Learning;
pub use newest::Newest;
pub use observation::{BEAMS_MAX, Bend, CHECKPOINTS, Checkpoint, Ego, Observation, Road};
pub use plan::{PLANNED_MAX, Plan, PlanOutcome, PlannedAction, WAYPOINTS_MAX, Waypoint};
pub use policy::{PolicyState, PolicyStatus, WEIGHTS_BYTES_MAX, Weights};
pub use progress::{Episode, Outcome, Progress};
pub use refusal::{REFUSALS, Refusal, RefusalKind, Refusals};
pub use roster::{PROCESSES, Roster};
pub use step::{Assessment, LATE_APART_NS, Proposal, ShadowProposal, Step, Timings, Verdict};
pub use takeover::Takeover;
pub use timing::{Histogram, LATE_TICKS, LateTick, Measure, Timing};

use crate::layout::Layout;
use crate::time::Instant;

crate::message! {
    /// The first part of every message.
    #[derive(Default)]
    pub struct Header: 32 bytes {
        /// The tick of the run this belongs to; the grid index in real time.
        pub tick: u64,
        /// When it was taken, on the run's clock, ns.
        pub taken_ns: u64,
        /// Counts this producer's messages from 1; a gap is a loss.
        pub sequence: u64,
        /// The episode of the run, from 0.
        pub episode: u32,
        /// Process id of the producer; a change means it was restarted.
        pub producer: u32,
    }
}

impl Header {
    /// When it was taken.
    pub fn taken(&self) -> Instant {
        Instant(self.taken_ns)
    }
}

/// How far a producer's clock may be ahead of the reader's. Both read the same clock,
/// so this is only the time between the reader's reading of the clock and of the
/// message.
pub const FUTURE_TOLERANCE_NS: u64 = 1_000_000;

/// A message that can be sent.
pub trait Message: Layout + crate::layout::Travels + Copy + core::fmt::Debug + 'static {
    /// The header.
    fn header(&self) -> &Header;

    /// The header, for the port that numbers messages.
    fn header_mut(&mut self) -> &mut Header;

    /// How many bytes of the message, from its first, are to be sent; those after them are
    /// zero for its readers. Less than all for a message that ends with a list of which
    /// only a part is used.
    fn used_bytes(&self) -> usize {
        size_of::<Self>()
    }

    /// Becomes equal to another message as far as that one is used; those bytes that it
    /// does not use become zeros, or stay so.
    fn assign(&mut self, from: &Self) {
        *self = *from;
    }

    /// Checks everything about the content that does not depend on time.
    ///
    /// # Errors
    /// The first field that is not finite, out of range, over its capacity or
    /// of unknown code.
    fn check(&self) -> Result<(), Refusal>;

    /// The check of a received message: content, then age. After it the message is
    /// trusted.
    ///
    /// # Errors
    /// As [`Message::check`]; and when the message is older than `limit_ns` or
    /// from the future.
    fn admit(&self, now: Instant, limit_ns: u64) -> Result<(), Refusal> {
        let taken = self.header().taken();
        let ahead_ns = taken.since_ns(now);
        if ahead_ns > FUTURE_TOLERANCE_NS {
            return Err(Refusal::Future { ahead_ns });
        }
        let age_ns = now.since_ns(taken);
        if age_ns > limit_ns {
            return Err(Refusal::Stale { age_ns, limit_ns });
        }
        self.check()
    }
}

/// Implements the two header accessors of [`Message`].
macro_rules! header_accessors {
    () => {
        fn header(&self) -> &crate::message::Header {
            &self.header
        }
        fn header_mut(&mut self) -> &mut crate::message::Header {
            &mut self.header
        }
    };
}
pub(crate) use header_accessors;

/// `value` is a number within `[low, high]`.
pub(crate) fn within(
    field: &'static str,
    value: f64,
    range: core::ops::RangeInclusive<f64>,
) -> Result<(), Refusal> {
    // The bounds are finite, so a non-finite value is in no range.
    if range.contains(&value) {
        return Ok(());
    }
    Err(match value.is_finite() {
        true => Refusal::OutOfRange { field, value },
        false => Refusal::NotFinite { field },
    })
}

/// `count` fits into `capacity`.
pub(crate) fn fits(field: &'static str, count: u64, capacity: usize) -> Result<(), Refusal> {
    let capacity = capacity as u64;
    if count > capacity {
        return Err(Refusal::OverCapacity {
            field,
            count,
            capacity,
        });
    }
    Ok(())
}

/// `code` is on its list.
pub(crate) fn known<T>(
    field: &'static str,
    code: u32,
    from_code: impl Fn(u32) -> Option<T>,
) -> Result<(), Refusal> {
    match from_code(code) {
        Some(_) => Ok(()),
        None => Err(Refusal::UnknownCode { field, code }),
    }
}
