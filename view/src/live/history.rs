//! The course of a run, a sample for each moment of the page: what its charts and bands
//! draw.

use serde::Serialize;
use shm_config::message::{Proposal, Step};

use super::scene::rounded;

/// Changes of the driver that one sample keeps; further ones of the same moment are
/// counted into the last.
const CHANGES_MAX: usize = 64;

/// The steps of one moment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sample {
    /// The last tick.
    pub tick: u64,
    /// When it was taken, s on the run's clock.
    pub taken_s: f64,
    /// Its episode, from 0.
    pub episode: u32,
    /// Steps in it.
    pub steps: u32,
    /// Pose of the car in the world frame: m, m, rad.
    pub ego_world: [f64; 3],
    /// Distance to the road's left and right edge, m; heading in the road's frame, rad.
    pub road: [f64; 3],
    /// m/s.
    pub speed_mps: f64,
    /// Speed that the plan wants next, m/s; `None` without a plan.
    pub planned_mps: Option<f64>,
    /// Steering and pedal of the command.
    pub command: [f64; 2],
    /// Of the expert's proposal.
    pub expert: Option<[f64; 2]>,
    /// Of the policy's proposal.
    pub policy: Option<[f64; 2]>,
    /// Tick, driver and reason at each change, as codes; the first of a run included.
    pub drivers: Vec<(u64, u32, u32)>,
    /// Age of the advice's question, s; `None` without one.
    pub advice_age_s: Option<f64>,
    /// What the advice prefers, by code.
    pub preference: u32,
    /// Longest time from a scheduled instant to the command, ms.
    pub response_ms: f64,
    /// Version of the weights.
    pub weights: u64,
}

/// Adds steps up to samples.
#[derive(Debug, Default)]
pub struct History {
    open: Option<Sample>,
    driver: Option<(u32, u32)>,
}

impl History {
    /// Adds a step that passed its check.
    pub fn add(&mut self, step: &Step) {
        let timings = &step.timings;
        let response_ns = timings.commanded_ns.saturating_sub(timings.scheduled_ns);
        let before = self.open.take();
        let mut sample = sample(step);
        sample.response_ms = rounded(response_ns as f64 / 1e6, 3);
        if let Some(before) = before {
            sample.response_ms = sample.response_ms.max(before.response_ms);
            sample.steps = before.steps + 1;
            sample.drivers = before.drivers;
        }
        let driver = (step.command.driver, step.command.reason);
        if self.driver != Some(driver) {
            self.driver = Some(driver);
            if sample.drivers.len() == CHANGES_MAX {
                sample.drivers.pop();
            }
            sample.drivers.push((step.header.tick, driver.0, driver.1));
        }
        self.open = Some(sample);
    }

    /// Lets the next step name its driver as the first one of a run does.
    pub fn forget_driver(&mut self) {
        self.driver = None;
    }

    /// The sample of all steps since the last [`History::take`], which goes on.
    pub fn open(&self) -> Option<&Sample> {
        self.open.as_ref()
    }

    /// The sample of all steps since the last call; `None` when there was none.
    pub fn take(&mut self) -> Option<Sample> {
        self.open.take()
    }
}

fn sample(step: &Step) -> Sample {
    let (ego, road) = (&step.observation.ego, &step.observation.road);
    let pair = |proposal: &Proposal| {
        let action = proposal.action()?;
        Some([rounded(action.steer, 3), rounded(action.pedal, 3)])
    };
    let next = step.plan.waypoints().get(1);
    Sample {
        tick: step.header.tick,
        taken_s: rounded(step.header.taken_ns as f64 * 1e-9, 4),
        episode: step.header.episode,
        steps: 1,
        ego_world: [
            rounded(ego.x_world_m, 2),
            rounded(ego.y_world_m, 2),
            rounded(ego.heading_world_rad, 4),
        ],
        road: [
            rounded(road.left_m, 2),
            rounded(road.right_m, 2),
            rounded(road.heading_rad, 4),
        ],
        speed_mps: rounded(ego.speed_mps, 3),
        planned_mps: next.map(|waypoint| rounded(waypoint.speed_mps, 2)),
        command: [
            rounded(step.command.steer, 3),
            rounded(step.command.pedal, 3),
        ],
        expert: pair(&step.expert),
        policy: pair(&step.policy),
        drivers: Vec::new(),
        advice_age_s: (step.advice_age_ns != u64::MAX)
            .then(|| rounded(step.advice_age_ns as f64 * 1e-9, 2)),
        preference: step.advice.preference,
        response_ms: 0.0,
        weights: step.weights_version,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shm_config::message::{Driver, Reason};

    fn step(tick: u64, driver: Driver, response_ns: u64) -> Step {
        let mut step = Step::default();
        step.header.tick = tick;
        step.timings.commanded_ns = response_ns;
        (step.command.driver, step.command.reason) = (driver.code(), Reason::Advised.code());
        step
    }

    #[test]
    fn a_sample_keeps_the_newest_step_the_worst_response_and_each_change() {
        let mut history = History::default();
        assert_eq!(history.take(), None);
        history.add(&step(1, Driver::Policy, 3_000_000));
        history.add(&step(2, Driver::Policy, 9_000_000));
        history.add(&step(3, Driver::Expert, 1_000_000));
        let sample = history.take().expect("a sample");
        assert_eq!((sample.tick, sample.steps, sample.response_ms), (3, 3, 9.0));
        let changes: Vec<_> = sample.drivers.iter().map(|(tick, ..)| *tick).collect();
        assert_eq!(changes, [1, 3]);
        history.add(&step(4, Driver::Expert, 1_000_000));
        let next = history.take().expect("a sample");
        assert_eq!((next.drivers.len(), next.steps), (0, 1));
        history.forget_driver();
        history.add(&step(5, Driver::Expert, 1_000_000));
        assert_eq!(history.open().map(|sample| sample.drivers.len()), Some(1));
    }

    #[test]
    fn changes_of_one_moment_are_bounded() {
        let mut history = History::default();
        for tick in 0..1_000 {
            let driver = [Driver::Expert, Driver::Policy][tick as usize % 2];
            history.add(&step(tick, driver, 0));
        }
        let sample = history.take().expect("a sample");
        assert_eq!(sample.drivers.len(), CHANGES_MAX);
        assert_eq!(sample.drivers.last().map(|last| last.0), Some(999));
    }
}
