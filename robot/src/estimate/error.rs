use shm_config::Instant;

/// Why the filter refuses an input. What it had estimated stays as it was.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum EstimateError {
    /// A setting or a number of the start is not finite or out of range.
    #[error("{name} = {value}: must be within {} and {}", .range[0], .range[1])]
    Setting {
        /// Which.
        name: &'static str,
        /// What it was.
        value: f64,
        /// The least and the most it may be.
        range: [f64; 2],
    },
    /// A measured number is not finite or out of range.
    #[error("{name} = {value}: no such measurement")]
    Value {
        /// Which.
        name: &'static str,
        /// What it was.
        value: f64,
    },
    /// An information matrix is not symmetric, not positive semidefinite, or zero.
    #[error("the information of the measurement is no information matrix")]
    Information,
    /// `now` is before the `now` of an earlier call.
    #[error("the clock went back from {} to {} ns", newest.0, now.0)]
    Clock {
        /// This call's.
        now: Instant,
        /// The newest.
        newest: Instant,
    },
    /// The measurement was taken after `now`.
    #[error("taken at {} ns, which is after {} ns", taken.0, now.0)]
    Future {
        /// When it was taken.
        taken: Instant,
        /// The call's.
        now: Instant,
    },
    /// It is older than the filter accepts: than [`Settings::delay_s`], or than its start.
    ///
    /// [`Settings::delay_s`]: super::Settings::delay_s
    #[error("taken at {} ns: nothing before {} ns is accepted", taken.0, oldest.0)]
    Late {
        /// When it was taken, or the instant that was asked for.
        taken: Instant,
        /// The oldest instant that is accepted.
        oldest: Instant,
    },
    /// The same kind of measurement of the same instant is there already.
    #[error("a second measurement of its kind taken at {} ns", taken.0)]
    Duplicate {
        /// When both were taken.
        taken: Instant,
    },
    /// A keyframe, when a newer keyframe or motion is there already: scans come in order.
    #[error("a keyframe of {} ns, after newer scans", taken.0)]
    OutOfOrder {
        /// When it was taken.
        taken: Instant,
    },
    /// A motion since an instant that is not that of the keyframe before it.
    #[error("a motion since {} ns: the keyframe is not of this instant", since.0)]
    Keyframe {
        /// What the motion says.
        since: Instant,
    },
    /// More measurements than the history holds within the delay.
    #[error("more than {} measurements within the accepted delay", super::HISTORY)]
    Full,
}
