use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::{Deserialize, Serialize};

use super::{Config, OutOfRange, in_range};

/// What drives the run's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Clock {
    /// In real time: a tick at each instant of a fixed monotonic grid.
    RealTime,
    /// As fast as the processes answer; the same seed gives the same commands.
    Lockstep,
}

/// Name, clock, seeds and length of the run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Run {
    /// Name of the run; it isolates the run from all others on the machine.
    pub name: String,
    /// What drives the clock.
    pub clock: Clock,
    /// Ticks of the controller per second, a multiple of 10 up to 1000; the
    /// paper's is 10 (Sec. 4.1.2: 0.1 s). World and planner have the same rate
    /// unless world.rate_hz and planner.rate_hz say otherwise.
    pub rate_hz: f64,
    /// Seed of the first episode; each further episode adds one.
    pub seed: u64,
    /// Number of different seeds, from run.seed on; 0 for no limit.
    pub seeds: u32,
    /// Seed of the random order of those seeds, which repeats; 0 for ascending order.
    pub shuffle: u64,
    /// Episodes to drive; 0 for no end.
    pub episodes: u32,
    /// Seconds to drive on the run's clock; 0 for no end.
    pub duration_s: f64,
    /// Folder of the run's configuration and logs.
    pub folder: String,
    /// Whether processes obey orders to hang, panic and run out of memory: for `bench
    /// faults` alone, never on a vehicle.
    pub faults: bool,
}

impl Default for Run {
    fn default() -> Self {
        Self {
            name: "default".into(),
            clock: Clock::RealTime,
            rate_hz: 10.0,
            seed: 1000,
            seeds: 0,
            shuffle: 0,
            episodes: 0,
            duration_s: 0.0,
            folder: "runs/default".into(),
            faults: false,
        }
    }
}

impl Run {
    /// Time from tick to tick, ns.
    pub fn period_ns(&self) -> u64 {
        (1e9 / self.rate_hz).round() as u64
    }

    /// Seed of an episode of the run.
    pub fn episode_seed(&self, episode: u32) -> u64 {
        let episode = u64::from(episode);
        let ahead = match (self.seeds, self.shuffle) {
            (0, _) => episode,
            (seeds, 0) => episode % u64::from(seeds),
            // The world in Python draws the same seeds (`world.py`).
            (seeds, shuffle) => mixed(shuffle.wrapping_add(episode)) % u64::from(seeds),
        };
        self.seed.wrapping_add(ahead)
    }

    /// Whether the clock is simulated.
    pub fn is_lockstep(&self) -> bool {
        self.clock == Clock::Lockstep
    }

    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        // The name must be short enough for the run's sockets, which only the wire
        // opens.
        #[cfg(feature = "wire")]
        self.name
            .parse::<crate::run::RunName>()
            .map_err(|_| OutOfRange {
                key: "run.name".into(),
                value: format!("{:?}", self.name),
                expected: format!(
                    "1 to {} letters, digits, '-' or '_'",
                    crate::run::name_max()
                ),
            })?;
        in_range("run.episodes", self.episodes, 0..=1_000_000)?;
        in_range("run.duration_s", self.duration_s, 0.0..=1e7)
    }
}

/// The number at this position, from 1, of the SplitMix64 stream with seed 0:
/// neighbouring positions have unrelated numbers.
fn mixed(place: u64) -> u64 {
    // SplitMix64 adds this to its state for each number, so any position can be
    // computed.
    const STEP: u64 = 0x9e37_79b9_7f4a_7c15;
    SplitMix64::seed_from_u64(place.wrapping_sub(1).wrapping_mul(STEP)).next_u64()
}

/// Age limits and waiting times: a process that falls silent stops the car.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Age limit of observations, ms; with an older one the controller brakes.
    pub observation_age_ms: f64,
    /// Age limit of plans, ms; with an older one the controller brakes. 0 for two and a
    /// half periods of the planner, but at least 250.
    pub plan_age_ms: f64,
    /// Age limit of commands, ms; with an older one the world brakes.
    pub command_age_ms: f64,
    /// Age limit of takeover messages, ms; after it the takeover ends.
    pub takeover_age_ms: f64,
    /// How long the controller waits for the plan of its observation, if the planner
    /// makes one, before it uses the previous plan, as a share of the controller's
    /// period.
    #[serde(skip)]
    pub plan_wait: f64,
    /// How long after the instant of the grid the controller ticks without a new
    /// observation, as a share of the controller's period.
    #[serde(skip)]
    pub observation_wait: f64,
    /// In lockstep: how long a process waits for another before it continues without
    /// it, s on the machine's clock.
    pub lockstep_wait_s: f64,
    /// In lockstep: how long the controller waits for the learner, s on the machine's
    /// clock; a silent learner is then not waited for until it publishes again. A block
    /// of updates takes seconds, on a busy machine ten times that.
    pub learner_wait_s: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            // Two lost ticks at 10 Hz are bridged, the third brakes: at the paper's 5
            // m/s the car has moved 1.25 m by then.
            observation_age_ms: 250.0,
            plan_age_ms: 0.0,
            command_age_ms: 250.0,
            // The keys are read at 20 Hz: five messages in a row may be late.
            takeover_age_ms: 300.0,
            plan_wait: 0.5,
            observation_wait: 0.5,
            lockstep_wait_s: 1.0,
            learner_wait_s: 120.0,
        }
    }
}

impl Limits {
    pub(super) fn check(&self, config: &Config) -> Result<(), OutOfRange> {
        // A limit of less than one and a half periods would brake at every jitter. The
        // controller reads observations once in its own period, however many the world
        // publishes.
        let least_ms = 1.5e3 / config.run.rate_hz;
        let ages = [
            ("limits.observation_age_ms", self.observation_age_ms),
            ("limits.command_age_ms", self.command_age_ms),
        ];
        for (key, value) in ages {
            in_range(key, value, least_ms..=10_000.0)?;
        }
        // Two of the supervisor's periods: with less, one late message would end a
        // takeover.
        in_range(
            "limits.takeover_age_ms",
            self.takeover_age_ms,
            100.0..=10_000.0,
        )?;
        if self.plan_age_ms != 0.0 {
            let least_ms = 1.5e3 / config.planner_rate_hz();
            in_range("limits.plan_age_ms", self.plan_age_ms, least_ms..=10_000.0)?;
        }
        in_range("limits.plan_wait", self.plan_wait, 0.0..=0.8)?;
        in_range("limits.observation_wait", self.observation_wait, 0.05..=0.9)?;
        in_range("limits.lockstep_wait_s", self.lockstep_wait_s, 0.01..=600.0)?;
        in_range("limits.learner_wait_s", self.learner_wait_s, 0.01..=600.0)
    }

    /// The limit in ns.
    pub fn observation_age_ns(&self) -> u64 {
        (self.observation_age_ms * 1e6) as u64
    }

    /// The limit in ns.
    pub fn command_age_ns(&self) -> u64 {
        (self.command_age_ms * 1e6) as u64
    }

    /// The limit in ns.
    pub fn takeover_age_ns(&self) -> u64 {
        (self.takeover_age_ms * 1e6) as u64
    }
}

/// Restarts and real-time privileges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Supervisor {
    /// Restarts of one process before the run is given up.
    pub restarts_max: u32,
    /// Pause before the first restart, ms; it doubles with each further one in a row.
    pub backoff_ms: f64,
    /// Longest pause before a restart, ms.
    pub backoff_max_ms: f64,
    /// A process that has run this long counts as healthy, and its pause starts over,
    /// s.
    pub healthy_s: f64,
    /// A process without a health message for this long is killed and restarted, s.
    pub silence_s: f64,
    /// Ask for real-time priority, own cores and locked memory.
    pub realtime: bool,
    /// Bound on the time that a sleeping processor needs to wake up while the set
    /// drives, us: 0 keeps all processors from sleeping, which costs power; a negative
    /// number asks for no bound. The supervisor asks for it if the run asks for
    /// real-time privileges.
    pub cpu_latency_us: i32,
    /// How long an orderly stop may take, s.
    pub stop_s: f64,
    /// Largest log file of a process, MB; one older file is kept beside it.
    pub log_mb: u32,
}

impl Default for Supervisor {
    fn default() -> Self {
        Self {
            restarts_max: 10,
            backoff_ms: 20.0,
            backoff_max_ms: 2000.0,
            healthy_s: 5.0,
            silence_s: 3.0,
            realtime: true,
            cpu_latency_us: 0,
            stop_s: 8.0,
            log_mb: 8,
        }
    }
}

impl Supervisor {
    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        in_range("supervisor.restarts_max", self.restarts_max, 0..=100_000)?;
        in_range("supervisor.backoff_ms", self.backoff_ms, 0.0..=60_000.0)?;
        in_range(
            "supervisor.backoff_max_ms",
            self.backoff_max_ms,
            self.backoff_ms..=600_000.0,
        )?;
        in_range("supervisor.healthy_s", self.healthy_s, 0.1..=3600.0)?;
        in_range("supervisor.silence_s", self.silence_s, 0.2..=3600.0)?;
        in_range(
            "supervisor.cpu_latency_us",
            self.cpu_latency_us,
            -1..=100_000,
        )?;
        in_range("supervisor.stop_s", self.stop_s, 0.1..=600.0)?;
        in_range("supervisor.log_mb", self.log_mb, 1..=1024)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The numbers of the published algorithm, which `world.py` computes too.
    #[test]
    fn shuffled_seeds_follow_the_published_numbers() {
        assert_eq!(mixed(0), 0);
        assert_eq!(mixed(1), 0xe220_a839_7b1d_cdaf);
        assert_eq!(mixed(2), 0x6e78_9e6a_a1b9_65f4);
        let run = Run {
            seeds: 50,
            shuffle: 7,
            ..Run::default()
        };
        let seeds: Vec<_> = (0..4).map(|episode| run.episode_seed(episode)).collect();
        assert_eq!(seeds, [1013, 1040, 1049, 1040]);
    }
}
