//! The relations between the rates of world, controller and planner.

use super::{Config, OutOfRange, Simulator, in_range};
use crate::services::Process;

/// Decisions of traffic and rules per second. Both worlds use the rate of MetaDrive,
/// which has no other.
pub const DECISION_HZ: f64 = 10.0;
/// A plan is followed for this many periods of the planner.
const PLAN_PERIODS: f64 = 2.5;
/// Least age up to which a plan is followed, ms: at the paper's 10 Hz, two lost plans
/// are bridged, the third brakes.
const PLAN_AGE_MS: f64 = 250.0;

impl Config {
    /// Instants of the world per second.
    pub fn world_rate_hz(&self) -> f64 {
        or_the_runs(self.world.rate_hz, self)
    }

    /// Plans per second.
    pub fn planner_rate_hz(&self) -> f64 {
        or_the_runs(self.planner.rate_hz, self)
    }

    /// The rate of a process; `None` for a process without a fixed rate.
    pub fn rate_hz(&self, process: Process) -> Option<f64> {
        match process {
            Process::World => Some(self.world_rate_hz()),
            Process::Controller => Some(self.run.rate_hz),
            Process::Planner => Some(self.planner_rate_hz()),
            Process::Supervisor | Process::Gate | Process::Learner | Process::Recorder => None,
        }
    }

    /// Time from tick to tick of a process, ns; `None` for a process without a grid.
    /// The world counts the run's ticks. A planner at a lower rate starts a new grid at
    /// each episode.
    pub fn tick_ns(&self, process: Process) -> Option<u64> {
        match process {
            Process::World | Process::Controller => Some(self.run.period_ns()),
            Process::Planner if self.plan_ticks() == 1 => Some(self.run.period_ns()),
            _ => None,
        }
    }

    /// Instants of the world in one tick of the run.
    pub fn world_instants(&self) -> u64 {
        ((self.world_rate_hz() / self.run.rate_hz).round() as u64).max(1)
    }

    /// Ticks of the run in an episode that ends at `world.horizon_ticks`.
    pub fn horizon_ticks(&self) -> u64 {
        let is_built_in =
            self.world.simulator == Simulator::BuiltIn && self.programs.world.is_empty();
        let each = match is_built_in {
            true => self.run.rate_hz / DECISION_HZ,
            false => 1.0,
        };
        (f64::from(self.world.horizon_ticks) * each).round() as u64
    }

    /// Ticks of the run from one plan to the next.
    pub fn plan_ticks(&self) -> u64 {
        ((self.run.rate_hz / self.planner_rate_hz()).round() as u64).max(1)
    }

    /// Age up to which a plan is followed, ns.
    pub fn plan_age_ns(&self) -> u64 {
        let given_ms = self.limits.plan_age_ms;
        let age_ms = match given_ms > 0.0 {
            true => given_ms,
            false => (PLAN_PERIODS * 1e3 / self.planner_rate_hz()).max(PLAN_AGE_MS),
        };
        (age_ms * 1e6) as u64
    }

    pub(super) fn check_rates(&self) -> Result<(), OutOfRange> {
        let run_hz = self.run.rate_hz;
        in_range("run.rate_hz", run_hz, DECISION_HZ..=1000.0)?;
        whole("run.rate_hz", run_hz, run_hz / DECISION_HZ, || {
            "a multiple of 10".into()
        })?;
        let world_hz = self.world.rate_hz;
        if world_hz != 0.0 {
            let key = "world.rate_hz";
            in_range(key, world_hz, DECISION_HZ..=1000.0)?;
            whole(key, world_hz, world_hz / run_hz, || {
                format!("0 or a multiple of run.rate_hz = {run_hz}")
            })?;
        }
        let planner_hz = self.planner.rate_hz;
        if planner_hz != 0.0 {
            let key = "planner.rate_hz";
            in_range(key, planner_hz, 1.0..=1000.0)?;
            whole(key, planner_hz, run_hz / planner_hz, || {
                format!("0, or run.rate_hz = {run_hz} divided by a whole number")
            })?;
        }
        self.check_metadrive()
    }

    /// The real MetaDrive has one rate, and no controller is faster than its world.
    fn check_metadrive(&self) -> Result<(), OutOfRange> {
        let world_hz = self.world_rate_hz();
        let is_metadrive =
            self.programs.world.is_empty() && self.world.simulator == Simulator::MetaDrive;
        if !is_metadrive || world_hz == DECISION_HZ {
            return Ok(());
        }
        let key = match self.world.rate_hz == 0.0 {
            true => "run.rate_hz",
            false => "world.rate_hz",
        };
        Err(OutOfRange {
            key: key.into(),
            value: world_hz.to_string(),
            expected: "10 with world.simulator = \"metadrive\", which steps at 10 Hz".into(),
        })
    }
}

fn or_the_runs(rate_hz: f64, config: &Config) -> f64 {
    match rate_hz == 0.0 {
        true => config.run.rate_hz,
        false => rate_hz,
    }
}

/// Refuses two rates whose quotient is not a whole number of at least 1.
fn whole(
    key: &str,
    value: f64,
    quotient: f64,
    expected: impl Fn() -> String,
) -> Result<(), OutOfRange> {
    let is_whole = quotient > 0.5 && (quotient - quotient.round()).abs() < 1e-9 * quotient;
    match is_whole {
        true => Ok(()),
        false => Err(OutOfRange {
            key: key.into(),
            value: value.to_string(),
            expected: expected(),
        }),
    }
}
