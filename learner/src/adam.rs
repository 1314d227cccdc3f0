//! Adam, as in PyTorch: Kingma and Ba, 2015, Algorithm 1; and its learning rate.

use serde::{Deserialize, Serialize};

/// Exponential decay of the first moment.
const BETA_1: f64 = 0.9;
/// Exponential decay of the second moment.
const BETA_2: f64 = 0.999;
/// Epsilon: keeps the division finite.
const EPSILON: f32 = 1e-8;

/// Smaller moments count as 0. Where a gradient stays 0 its moments fade, and processors are many
/// times slower with subnormal numbers, which are below 1e-38; a step is the moment times the rate,
/// which may be 1e-5. A first moment as small moves a parameter by at most 1e-27, and the root of a
/// second one is a ten-millionth of [`EPSILON`], or a few in the first steps.
const TINY: f32 = 1e-32;

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
        for part in self.begin_step(parameters.len().max(1)) {
            part.step(parameters, gradient);
        }
    }

    /// Begins a step, which is taken part by part, each of this many parameters, except the last.
    ///
    /// # Panics
    /// With 0.
    pub fn begin_step(&mut self, count: usize) -> impl ExactSizeIterator<Item = Part<'_>> {
        let rate = self.rate.at(self.steps);
        self.steps += 1;
        let steps = i32::try_from(self.steps).unwrap_or(i32::MAX);
        let first_share = 1.0 - BETA_1.powi(steps);
        let second_share = 1.0 - BETA_2.powi(steps);
        let rate = rate * (1.0 / first_share) as f32;
        let root = (1.0 / second_share.sqrt()) as f32;
        let firsts = self.first.chunks_mut(count);
        let moments = firsts.zip(self.second.chunks_mut(count));
        moments.map(move |(first, second)| Part {
            rate,
            root,
            first,
            second,
        })
    }
}

/// The moments of some parameters, and the two factors of their next step.
#[derive(Debug)]
pub struct Part<'a> {
    rate: f32,
    root: f32,
    first: &'a mut [f32],
    second: &'a mut [f32],
}

impl Part<'_> {
    /// Steps with these parameters, against their gradient.
    pub fn step(self, parameters: &mut [f32], gradient: &[f32]) {
        let (beta_1, beta_2) = (BETA_1 as f32, BETA_2 as f32);
        let moments = self.first.iter_mut().zip(self.second);
        for ((parameter, &slope), (first, second)) in
            parameters.iter_mut().zip(gradient).zip(moments)
        {
            // In variables: the compiler would read `*first` again, since it may be `*second`.
            let mean = faded(beta_1 * *first + (1.0 - beta_1) * slope);
            let square = faded(beta_2 * *second + (1.0 - beta_2) * slope * slope);
            (*first, *second) = (mean, square);
            *parameter -= self.rate * mean / (square.sqrt() * self.root + EPSILON);
        }
    }
}

/// A moment, or 0 if it is tiny.
fn faded(moment: f32) -> f32 {
    match moment.abs() < TINY {
        true => 0.0,
        false => moment,
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

    #[test]
    fn a_step_in_parts_is_the_step_in_one() {
        let (mut whole, mut parts) = (
            Adam::new(7, Rate::constant(0.1)),
            Adam::new(7, Rate::constant(0.1)),
        );
        let (mut place, mut place_in_parts) = ([1.0; 7], [1.0; 7]);
        for round in 0..5 {
            let gradient: [f32; 7] = std::array::from_fn(|k| (k * round) as f32 - 3.0);
            whole.step(&mut place, &gradient);
            let slopes = place_in_parts.chunks_mut(3).zip(gradient.chunks(3));
            for (part, (place, gradient)) in parts.begin_step(3).zip(slopes) {
                part.step(place, gradient);
            }
            assert_eq!(place, place_in_parts);
        }
        assert_eq!(whole, parts);
    }

    #[test]
    fn moments_without_a_gradient_fade_to_zero_and_parameters_end_where_they_would_without() {
        let mut adam = Adam::new(2, Rate::constant(1e-3));
        let mut place = [0.5_f32, 1.0];
        let (mut first, mut second, mut plain) = ([0.0_f32; 2], [0.0_f32; 2], place);
        let mut subnormal = 0;
        for step in 1..=80_000 {
            let gradient = if step == 1 { [1.0, 1e-3] } else { [0.0; 2] };
            adam.step(&mut place, &gradient);
            let rate = 1e-3 * (1.0 / (1.0 - 0.9_f64.powi(step))) as f32;
            let root = (1.0 / (1.0 - 0.999_f64.powi(step)).sqrt()) as f32;
            for k in 0..2 {
                let slope = gradient[k];
                first[k] = 0.9 * first[k] + (1.0 - 0.9_f32) * slope;
                second[k] = 0.999 * second[k] + (1.0 - 0.999_f32) * slope * slope;
                plain[k] -= rate * first[k] / (second[k].sqrt() * root + 1e-8);
                subnormal += u32::from(first[k].is_subnormal());
            }
            assert_eq!(place, plain, "step {step}");
        }
        assert!(subnormal > 100_000, "the test would show nothing");
        assert_eq!(
            (&adam.first[..], &adam.second[..]),
            (&[0.0; 2][..], &[0.0; 2][..])
        );
    }
}
