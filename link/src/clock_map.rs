//! The other machine's clock by four time stamps, as NTP has them.
//!
//! A ping carries its sender's time `t1`; the answer adds when it came, `t2`, and when the
//! answer left, `t3`, by the other clock; it comes back at `t4`. The other clock is then
//! `((t2 - t1) + (t3 - t4)) / 2` ahead, and wrong by at most half of the round trip
//! `(t4 - t1) - (t3 - t2)`, however unequal the ways there and back are. The sample of the
//! shortest round trip counts, until it is too old.

use std::collections::VecDeque;

/// Samples that are kept: at five a second 13 s.
const SAMPLES: usize = 64;
/// How far two clocks may run apart, ns in a second: 100 ppm, twice a cheap quartz. A sample
/// becomes less certain by it as it ages.
const DRIFT_NS_PER_S: u64 = 100_000;
/// Samples in a row outside of what the map holds possible until the clock counts as jumped:
/// one alone may have waited in a stopped process between two of its readings.
const JUMPED_AFTER: u32 = 3;
/// Between the two ends of a drift estimate, ns: less is within the noise of the network.
const DRIFT_OVER_NS: u64 = 5_000_000_000;

/// The four time stamps of a ping, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamps {
    /// It left, by this clock.
    pub t1: u64,
    /// It came, by the other clock.
    pub t2: u64,
    /// Its answer left, by the other clock.
    pub t3: u64,
    /// Its answer came, by this clock.
    pub t4: u64,
}

#[derive(Debug, Clone, Copy)]
struct Sample {
    offset_ns: i64,
    round_trip_ns: u64,
    at: u64,
}

impl Sample {
    /// Half of the round trip, and what the clocks may have run apart since.
    fn uncertainty_ns(&self, now: u64) -> u64 {
        let age_ns = now.saturating_sub(self.at);
        self.round_trip_ns.div_ceil(2) + age_ns / 1_000_000 * DRIFT_NS_PER_S / 1_000
    }
}

/// What is known of the other clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mapped {
    /// How far the other clock is ahead of this one, ns.
    pub offset_ns: i64,
    /// How far off that may be, ns.
    pub uncertainty_ns: u64,
    /// The shortest round trip, ns.
    pub round_trip_ns: u64,
}

/// What a sample has shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    /// Nothing new.
    Agrees,
    /// Impossible stamps: an answer before its question.
    Impossible,
    /// A sample outside of the map; the next ones decide.
    Doubtful,
    /// The other clock has jumped by this, ns; the map begins anew.
    Jumped(i64),
}

/// The map of the other clock.
#[derive(Debug, Default)]
pub struct ClockMap {
    samples: VecDeque<Sample>,
    doubtful: u32,
    /// Times that the other clock has jumped.
    pub jumps: u64,
}

impl ClockMap {
    /// Takes the stamps of one answer.
    pub fn take(&mut self, stamps: Stamps) -> Shown {
        let Stamps { t1, t2, t3, t4 } = stamps;
        let (Some(away), Some(there)) = (t4.checked_sub(t1), t3.checked_sub(t2)) else {
            return Shown::Impossible;
        };
        let Some(round_trip_ns) = away.checked_sub(there) else {
            return Shown::Impossible;
        };
        let difference = |a: u64, b: u64| i128::from(a) - i128::from(b);
        let offset = (difference(t2, t1) + difference(t3, t4)) / 2;
        let Ok(offset_ns) = i64::try_from(offset) else {
            return Shown::Impossible;
        };
        let sample = Sample {
            offset_ns,
            round_trip_ns,
            at: t4,
        };
        if let Some(best) = self.best(t4).copied() {
            let apart = offset_ns.abs_diff(best.offset_ns);
            if apart > best.uncertainty_ns(t4) + sample.uncertainty_ns(t4) {
                self.doubtful += 1;
                if self.doubtful < JUMPED_AFTER {
                    return Shown::Doubtful;
                }
                let by_ns = offset_ns.saturating_sub(best.offset_ns);
                self.samples.clear();
                self.samples.push_back(sample);
                self.doubtful = 0;
                self.jumps += 1;
                return Shown::Jumped(by_ns);
            }
        }
        self.doubtful = 0;
        if self.samples.len() == SAMPLES {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
        Shown::Agrees
    }

    /// How many samples it holds.
    pub fn samples(&self) -> usize {
        self.samples.len()
    }

    fn best(&self, now: u64) -> Option<&Sample> {
        let samples = self.samples.iter();
        samples.min_by_key(|sample| sample.uncertainty_ns(now))
    }

    /// The other clock as far as it is known.
    pub fn mapped(&self, now: u64) -> Option<Mapped> {
        let best = self.best(now)?;
        Some(Mapped {
            offset_ns: best.offset_ns,
            uncertainty_ns: best.uncertainty_ns(now),
            round_trip_ns: best.round_trip_ns,
        })
    }

    /// How fast the other clock gains on this one, parts in a million, by the best samples
    /// of the older and of the newer half; `None` while the network hides it.
    pub fn drift_ppm(&self) -> Option<f64> {
        let half = self.samples.len() / 2;
        let best = |samples: &mut dyn Iterator<Item = &Sample>| {
            samples.min_by_key(|sample| sample.round_trip_ns).copied()
        };
        let older = best(&mut self.samples.iter().take(half))?;
        let newer = best(&mut self.samples.iter().skip(half))?;
        let over_ns = newer.at.checked_sub(older.at)?;
        let gained_ns = newer.offset_ns.checked_sub(older.offset_ns)?;
        let noise_ns = (older.round_trip_ns + newer.round_trip_ns) / 2;
        let is_shown = over_ns >= DRIFT_OVER_NS && gained_ns.unsigned_abs() > noise_ns;
        is_shown.then(|| gained_ns as f64 / over_ns as f64 * 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    /// Two clocks `ahead_ns` apart, with unequal ways there and back.
    fn ping(at: u64, ahead_ns: i64, (there, back): (u64, u64)) -> Stamps {
        let other = |own: u64| own.saturating_add_signed(ahead_ns);
        Stamps {
            t1: at,
            t2: other(at + there),
            t3: other(at + there + MS),
            t4: at + there + MS + back,
        }
    }

    #[test]
    fn the_offset_is_within_its_uncertainty_for_any_two_ways() {
        for (there, back) in [(0, 0), (MS, MS), (50 * MS, MS), (MS, 90 * MS)] {
            for ahead_ns in [0, 7_000_000_000, -3_000_000_000] {
                let mut map = ClockMap::default();
                let stamps = ping(10_000_000_000, ahead_ns, (there, back));
                assert_eq!(map.take(stamps), Shown::Agrees);
                let mapped = map.mapped(stamps.t4).expect("a map");
                let off = mapped.offset_ns.abs_diff(ahead_ns);
                assert!(off <= mapped.uncertainty_ns, "{off} {mapped:?}");
                assert_eq!(mapped.round_trip_ns, there + back);
            }
        }
    }

    #[test]
    fn the_shortest_round_trip_counts() {
        let mut map = ClockMap::default();
        for (k, way) in [(40, 10), (1, 1), (30, 80)].into_iter().enumerate() {
            let at = (k as u64 + 1) * 200 * MS;
            map.take(ping(at, 5_000_000, (way.0 * MS, way.1 * MS)));
        }
        let mapped = map.mapped(700 * MS).expect("a map");
        assert_eq!(
            (mapped.offset_ns, mapped.round_trip_ns),
            (5_000_000, 2 * MS)
        );
        assert!(mapped.uncertainty_ns >= MS);
    }

    #[test]
    fn an_old_sample_becomes_less_certain() {
        let mut map = ClockMap::default();
        map.take(ping(MS, 0, (MS, MS)));
        let at = |s: u64| map.mapped(s * 1_000 * MS).expect("a map").uncertainty_ns;
        assert!(
            (at(11) - at(1)).abs_diff(1_000_000) < 1_000,
            "100 ppm over 10 s"
        );
    }

    #[test]
    fn a_jump_is_told_after_three_samples_and_one_outlier_is_not() {
        let mut map = ClockMap::default();
        let way = (MS, MS);
        for k in 1..=20 {
            assert_eq!(map.take(ping(k * 200 * MS, 0, way)), Shown::Agrees);
        }
        assert_eq!(map.take(ping(4_200 * MS, 60_000_000, way)), Shown::Doubtful);
        assert_eq!(map.take(ping(4_400 * MS, 0, way)), Shown::Agrees);
        for k in [23, 24] {
            assert_eq!(
                map.take(ping(k * 200 * MS, 60_000_000, way)),
                Shown::Doubtful
            );
        }
        assert_eq!(
            map.take(ping(5_000 * MS, 60_000_000, way)),
            Shown::Jumped(60_000_000)
        );
        assert_eq!(map.jumps, 1);
        let mapped = map.mapped(5_010 * MS).expect("a map");
        assert_eq!(mapped.offset_ns, 60_000_000);
    }

    #[test]
    fn a_drift_is_measured() {
        let mut map = ClockMap::default();
        for k in 1..=60_u64 {
            // 500 ppm: 100 us in 200 ms; inside of the uncertainty of a slow network.
            let ahead_ns = (k * 100_000) as i64;
            map.take(ping(k * 200 * MS, ahead_ns, (MS / 2, MS / 2)));
        }
        let drift_ppm = map.drift_ppm().expect("a drift");
        assert!((drift_ppm - 500.0).abs() < 50.0, "{drift_ppm}");
    }

    #[test]
    fn impossible_stamps_change_nothing() {
        let mut map = ClockMap::default();
        let (early, late) = (MS, 2 * MS);
        for stamps in [
            Stamps {
                t1: late,
                t2: 0,
                t3: 0,
                t4: early,
            },
            Stamps {
                t1: 0,
                t2: late,
                t3: early,
                t4: late,
            },
            Stamps {
                t1: 0,
                t2: 0,
                t3: u64::MAX,
                t4: early,
            },
        ] {
            assert_eq!(map.take(stamps), Shown::Impossible);
        }
        assert_eq!(map.mapped(late), None);
        let far = Stamps {
            t1: 0,
            t2: u64::MAX,
            t3: u64::MAX,
            t4: early,
        };
        assert_eq!(map.take(far), Shown::Impossible);
    }
}
