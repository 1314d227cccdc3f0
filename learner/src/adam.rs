//! Adam, as in PyTorch: Kingma and Ba, 2015, Algorithm 1; and its learning rate.

use serde::{Deserialize, Serialize};

/// Exponential decay of the first moment.
const BETA_1: f64 = 0.9;
/// Exponential decay of the second moment.
const BETA_2: f64 = 0.999;
/// Epsilon: keeps the division finite.
const EPSILON: f32 = 1e-8;

/// What is left of a rate that has fallen: a learner that is run for longer than planned
/// still learns.
const LAST_SHARE: f64 = 0.01;

/// A learning rate, which stays or falls in a straight line.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    /// At the first step.
    pub start: f32,
    /// Steps after which a hundredth of it is left; 0 if it stays.
    pub decay_steps: u32,
}

impl Rate {
    /// One that stays.
    pub const fn constant(start: f32) -> Rate {
        Rate {
            start,
            decay_steps: 0,
        }
    }

    /// After this many steps.
    pub fn at(self, steps: u64) -> f32 {
        if self.decay_steps == 0 {
            return self.start;
        }
        let share = 1.0 - steps as f64 / f64::from(self.decay_steps);
        (f64::from(self.start) * share.max(LAST_SHARE)) as f32
    }
}

/// The optimiser of one network.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    /// Learning rate.
    pub rate: Rate,
    first: Vec<f32>,
    second: Vec<f32>,
    steps: u64,
}

impl Adam {
    /// An optimiser for this many parameters.
    pub fn new(parameters: usize, rate: Rate) -> Adam {
        Adam {
            rate,
            first: vec![0.0; parameters],
            second: vec![0.0; parameters],
            steps: 0,
        }
    }

    /// One step against the gradient.
    pub fn step(&mut self, parameters: &mut [f32], gradient: &[f32]) {
        let rate = self.rate.at(self.steps);
        self.steps += 1;
        let steps = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let first_share = 1.0 - BETA_1.powi(steps);
        let second_share = 1.0 - BETA_2.powi(steps);
        let rate = rate * (1.0 / first_share) as f32;
        let root = (1.0 / second_share.sqrt()) as f32;
        let (beta_1, beta_2) = (BETA_1 as f32, BETA_2 as f32);
        let moments = self.first.iter_mut().zip(&mut self.second);
        for ((parameter, &slope), (first, second)) in
            parameters.iter_mut().zip(gradient).zip(moments)
        {
            *first = beta_1 * *first + (1.0 - beta_1) * slope;
            *second = beta_2 * *second + (1.0 - beta_2) * slope * slope;
            *parameter -= rate * *first / (second.sqrt() * root + EPSILON);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Adam, Rate};

    #[test]
    fn a_rate_stays_or_falls_to_a_hundredth_and_no_further() {
        assert_eq!(Rate::constant(0.25).at(u64::MAX), 0.25);
        let falls = Rate {
            start: 0.5,
            decay_steps: 200,
        };
        let rates = [0, 50, 100, 198, 200, u64::MAX].map(|steps| falls.at(steps));
        assert_eq!(rates, [0.5, 0.375, 0.25, 0.005, 0.005, 0.005]);
    }

    #[test]
    fn steps_are_as_long_as_the_rate_at_the_time() {
        let rate = Rate {
            start: 0.5,
            decay_steps: 2,
        };
        let mut adam = Adam::new(1, rate);
        let mut place = [0.0];
        // Against an even slope Adam moves by its rate.
        for expected in [-0.5, -0.75, -0.755, -0.76] {
            adam.step(&mut place, &[1.0]);
            assert!((place[0] - expected).abs() < 1e-4_f32, "{place:?}");
        }
    }
}
