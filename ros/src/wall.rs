//! The wall clock beside the monotonic clock.
//!
//! Stamps of ROS 2 messages are wall time; a run has the monotonic clock, which is never set.
//! A time service that adjusts the rate of the wall clock adjusts that of Linux's monotonic
//! clock alike. So the difference of the two changes only when the wall clock is set, be it by
//! hours or, as time services of virtual machines do, by milliseconds again and again.

use std::time::SystemTime;

use shm_config::Instant;
use shm_config::time::monotonic;

/// A change of the difference from look to look that is told, ns. Smaller ones are followed
/// without a line: some time services make one every few seconds.
const JUMP_NS: u64 = 10_000_000;

/// Both clocks at one moment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Moment {
    /// The monotonic clock.
    pub now: Instant,
    /// Nanoseconds since the epoch by the wall clock.
    pub epoch_ns: u64,
}

impl Moment {
    /// Reads both.
    #[allow(clippy::disallowed_methods)] // the programs of this crate read the clocks here
    pub fn now() -> Self {
        let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
        Self {
            now: monotonic(),
            // A wall clock before 1970 is none.
            epoch_ns: since.map_or(0, |since| since.as_nanos() as u64),
        }
    }

    /// Wall time minus monotonic time, ns.
    pub fn offset_ns(&self) -> u64 {
        self.epoch_ns.saturating_sub(self.now.0)
    }

    /// How old a stamp is by the wall clock, ns; negative for a stamp from the future.
    pub fn age_ns(&self, stamp_epoch_ns: u64) -> i64 {
        let age = i128::from(self.epoch_ns) - i128::from(stamp_epoch_ns);
        age.clamp(i128::from(i64::MIN), i128::from(i64::MAX)) as i64
    }
}

/// Watches the difference of the clocks.
#[derive(Debug, Clone, Copy)]
pub struct Wall {
    offset_ns: u64,
}

impl Wall {
    /// With the difference of this moment.
    pub fn new(moment: Moment) -> Self {
        Self {
            offset_ns: moment.offset_ns(),
        }
    }

    /// Wall time minus monotonic time at the last look, ns.
    pub fn offset_ns(&self) -> u64 {
        self.offset_ns
    }

    /// Takes the difference of this moment; by how much the wall clock has jumped since the
    /// last look, s, if that is to be told.
    pub fn look(&mut self, moment: Moment) -> Option<f64> {
        let before_ns = std::mem::replace(&mut self.offset_ns, moment.offset_ns());
        let has_jumped = before_ns.abs_diff(self.offset_ns) > JUMP_NS;
        has_jumped.then(|| (i128::from(self.offset_ns) - i128::from(before_ns)) as f64 * 1e-9)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moment(now_ns: u64, epoch_ns: u64) -> Moment {
        Moment {
            now: Instant(now_ns),
            epoch_ns,
        }
    }

    #[test]
    fn a_large_jump_is_told_once_and_a_small_one_is_only_followed() {
        let mut wall = Wall::new(moment(100, 1_000_000_000_100));
        assert_eq!(wall.offset_ns(), 1_000_000_000_000);
        assert_eq!(wall.look(moment(1_000_000_100, 1_001_000_500_100)), None);
        assert_eq!(wall.offset_ns(), 1_000_000_500_000);
        let jumped_s = wall.look(moment(2_000_000_100, 1_005_000_500_100));
        assert_eq!(jumped_s, Some(3.0));
        let jumped_s = wall.look(moment(2_000_000_100, 2_500_100));
        assert!(jumped_s.is_some_and(|by_s| by_s < -1_000.0), "{jumped_s:?}");
        // Told once.
        assert_eq!(wall.look(moment(3_000_000_100, 1_002_500_100)), None);
    }

    #[test]
    fn a_stamp_has_an_age_and_a_hostile_one_does_not_overflow() {
        let now = moment(0, 1_000);
        assert_eq!([now.age_ns(400), now.age_ns(1_400)], [600, -400]);
        assert_eq!(now.age_ns(u64::MAX), i64::MIN);
    }
}
