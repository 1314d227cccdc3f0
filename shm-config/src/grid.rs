//! The instants at which the ticks of a run are due, and which observations belong to
//! them.

use crate::config::Config;
use crate::layout::{FNV_BASIS, fnv1a};
use crate::message::{FUTURE_TOLERANCE_NS, Message, Observation, Refusal};
use crate::time::Instant;

/// The grid that all processes of a run share: whole periods after a phase that follows
/// from the run's name. All worlds of a run keep it, also restarted ones, so `elapsed /
/// period` stays a whole number over restarts. Runs side by side have different phases
/// and do not tick at the same time.
///
/// In lockstep the run's clock is the world's, and only contents are checked.
#[derive(Debug, Clone, Copy)]
pub struct RunGrid {
    lockstep: bool,
    period_ns: u64,
    phase_ns: u64,
    age_limit_ns: u64,
}

impl RunGrid {
    /// The grid of a configuration.
    pub fn of(config: &Config) -> Self {
        let period_ns = config.run.period_ns();
        Self {
            lockstep: config.run.is_lockstep(),
            period_ns,
            phase_ns: fnv1a(FNV_BASIS, config.run.name.as_bytes()) % period_ns,
            age_limit_ns: config.limits.observation_age_ns(),
        }
    }

    /// The first instant that lies at least one period ahead, so that every process is
    /// ready.
    pub fn first_instant(&self, now: Instant) -> Instant {
        let least_ns = now.0 + self.period_ns;
        Instant(least_ns + (self.period_ns - self.off_ns(least_ns)) % self.period_ns)
    }

    /// Nanoseconds since the latest instant of the grid.
    fn off_ns(&self, instant_ns: u64) -> u64 {
        let (period, phase) = (self.period_ns, self.phase_ns);
        (instant_ns % period + period - phase) % period
    }

    /// The check of observations: content, age, and a scheduled instant on the grid
    /// within the same age limit. It comes before an observation is given a tick's
    /// number.
    ///
    /// # Errors
    /// As [`Message::admit`]; also when the scheduled instant is off the grid, in the
    /// future, or older than the age limit and one period. The extra period admits all
    /// observations of a tick until the next tick is due.
    pub fn admit(&self, observation: &Observation, now: Instant) -> Result<(), Refusal> {
        if self.lockstep {
            return observation.check();
        }
        observation.admit(now, self.age_limit_ns)?;
        let scheduled = Instant(observation.scheduled_ns);
        let ahead_ns = scheduled.since_ns(now);
        if ahead_ns > FUTURE_TOLERANCE_NS {
            return Err(Refusal::Future { ahead_ns });
        }
        let (age_ns, limit_ns) = (now.since_ns(scheduled), self.age_limit_ns + self.period_ns);
        if age_ns > limit_ns {
            return Err(Refusal::Stale { age_ns, limit_ns });
        }
        match self.off_ns(observation.scheduled_ns) {
            0 => Ok(()),
            off_ns => Err(Refusal::Grid { off_ns }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: Instant = Instant(5_123_456_789);

    #[test]
    fn worlds_of_a_run_share_the_phase_of_their_grid() {
        let mut config = Config::default();
        let grid = RunGrid::of(&config);
        let period_ns = config.run.period_ns();
        let first = grid.first_instant(NOW);
        for passed_ns in [0, 1, period_ns / 3, period_ns, 7 * period_ns + 12_345] {
            let now = NOW.after_ns(passed_ns);
            let next = grid.first_instant(now);
            assert_eq!(next.since_ns(first) % period_ns, 0, "{passed_ns}");
            let ahead_ns = next.since_ns(now);
            assert!((period_ns..2 * period_ns).contains(&ahead_ns), "{ahead_ns}");
        }
        config.run.name = "another".into();
        let other = RunGrid::of(&config).first_instant(NOW);
        assert_ne!(other, first, "runs side by side do not tick at once");
    }

    #[test]
    fn an_observation_off_the_grid_or_of_another_time_is_refused_with_its_reason() {
        let config = Config::default();
        let grid = RunGrid::of(&config);
        let period_ns = config.run.period_ns();
        let due = grid.first_instant(NOW);
        let now = due.after_ns(3_000_000);
        let seen = |scheduled_ns: u64| {
            let mut observation = Observation::default();
            observation.header.taken_ns = now.0;
            observation.scheduled_ns = scheduled_ns;
            grid.admit(&observation, now)
                .map_err(|refusal| refusal.kind().word())
        };
        assert_eq!(seen(due.0), Ok(()));
        assert_eq!(seen(due.0 - period_ns), Ok(()), "a slow world's");
        assert_eq!(seen(due.0 - period_ns / 2), Err("grid"));
        assert_eq!(seen(due.0 + 1), Err("grid"));
        assert_eq!(seen(due.0 + period_ns), Err("future"));
        assert_eq!(seen(due.0 - 40 * period_ns), Err("stale"));
        assert_eq!(seen(1), Err("stale"), "no grid ever begins there");
        let mut lockstep = config;
        lockstep.run.clock = crate::config::Clock::Lockstep;
        let observation = Observation::default();
        assert_eq!(RunGrid::of(&lockstep).admit(&observation, now), Ok(()));
    }
}
