//! The algorithms, one file each, with their hyper-parameters and the sources of these
//! at the top.
//!
//! | algorithm | learns from | loss |
//! |---|---|---|
//! | `bc` | the expert's own driving ([`regression`]) | squared error |
//! | `hg-dagger` | the steps at which the expert was preferred ([`regression`]) | squared error |
//! | `dagger` | every step and imagined scenes: the expert is a program and answers everywhere ([`regression`]) | squared error |
//! | `pvp` | preferences and what followed ([`pvp`]) | twin critics, Eq. 1 and 2 |
//! | `ppl` | preferences, at predicted states, too, and imagined scenes ([`ppl`]) | squared error and pairs |

pub mod ppl;
pub mod pvp;
pub mod regression;

use rand::Rng;
use serde::{Deserialize, Serialize};
use shm_config::message::INPUTS_WITH_MOTION;

use crate::network::{CHUNK, Head, Network, follow};
use crate::replay::{ACTIONS, Buffer, Replay};
use crate::share::share;
use crate::{Adam, Rate, features};

pub use ppl::Ppl;
pub use pvp::Pvp;
pub use regression::{Regression, Source};

/// The sizes that all algorithms have.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// Numbers that a policy takes: 259, or 379 with how bodies move.
    pub inputs: usize,
    /// Neurons of each of the two hidden layers.
    pub hidden: usize,
    /// Filters of each of the two convolutions before them; 0 for none.
    pub filters: usize,
    /// Transitions in an update.
    pub batch: usize,
}

impl Size {
    /// The values that a learner keeps from its start, by configuration key.
    fn begun_with(self, rate: Rate) -> Vec<(&'static str, f64)> {
        let takes_motion = self.inputs == INPUTS_WITH_MOTION;
        vec![
            ("learner.motion", f64::from(u8::from(takes_motion))),
            ("learner.hidden", self.hidden as f64),
            ("learner.filters", self.filters as f64),
            ("learner.batch", self.batch as f64),
            ("learner.rate", f64::from(rate.start)),
            ("learner.decay_updates", f64::from(rate.decay_steps)),
        ]
    }
}

/// The losses of an update; zero for those that an algorithm does not have.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Loss of the actor, imitation included.
    pub actor: f32,
    /// Loss of the imitation alone.
    pub imitation: f32,
    /// Loss of the critics.
    pub critic: f32,
}

/// A network and its optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Learned {
    /// The network.
    pub network: Network,
    /// Its optimiser.
    pub adam: Adam,
    /// The gradient of the last backward pass; not stored.
    #[serde(skip)]
    gradient: Vec<f32>,
}

impl Learned {
    /// A network with random parameters, and its optimiser.
    pub fn new(sizes: &[usize], head: Head, rate: Rate, random: &mut impl Rng) -> Learned {
        Learned::of(Network::new(sizes, head, random), rate)
    }

    /// This network and its optimiser.
    fn of(network: Network, rate: Rate) -> Learned {
        let count = network.parameters().len();
        Learned {
            network,
            adam: Adam::new(count, rate),
            gradient: Vec::new(),
        }
    }

    /// Takes one step of the optimiser against the gradient. A follower, a network of the same
    /// sizes, then moves towards this one by a share ([`follow`]).
    fn step(&mut self, threads: usize, follower: Option<(&mut Network, f32)>) {
        let count = self.network.parameters().len();
        assert_eq!(self.gradient.len(), count, "a step without a backward pass");
        let parameters = self.network.parameters_mut().chunks_mut(CHUNK);
        let parts = self.adam.begin_step(CHUNK).zip(parameters);
        let parts = parts.zip(self.gradient.chunks(CHUNK));
        match follower {
            None => share(threads, parts, |((adam, parameters), gradient)| {
                adam.step(parameters, gradient);
            }),
            Some((follower, rate)) => {
                let followers = follower.parameters_mut().chunks_mut(CHUNK);
                share(threads, parts.zip(followers), |(own, follower)| {
                    let ((adam, parameters), gradient) = own;
                    adam.step(parameters, gradient);
                    follow(follower, parameters, rate);
                });
            }
        }
    }
}

/// An actor of the configured size: 259-256-256-2 by default.
pub fn actor(size: Size, rate: Rate, random: &mut impl Rng) -> Learned {
    let sizes = [size.inputs, size.hidden, size.hidden, ACTIONS];
    let convolutions = match size.filters {
        0 => Vec::new(),
        filters => features::convolutions(size.inputs, filters),
    };
    let network = Network::convolved(convolutions, &sizes, Head::Tanh, random);
    Learned::of(network, rate)
}

/// An algorithm's state: networks, optimisers, and all else that outlives an update.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Student {
    /// Imitation (`bc`, `hg-dagger`, `dagger`).
    Regression(Regression),
    /// Proxy values (`pvp`).
    Pvp(Box<Pvp>),
    /// Pairs at predicted states (`ppl`).
    Ppl(Ppl),
}

impl Student {
    /// One update from the replay, with at most this many threads. The number of
    /// threads changes no bit of the result. Does nothing when the replay buffers it
    /// needs are empty.
    pub fn update(&mut self, replay: &Replay, random: &mut impl Rng, threads: usize) -> Losses {
        match self {
            Student::Regression(student) => student.update(replay, random, threads),
            Student::Pvp(student) => student.update(replay, random, threads),
            Student::Ppl(student) => student.update(replay, random, threads),
        }
    }

    /// The replay buffers that it learns from.
    pub fn buffers(&self) -> &'static [Buffer] {
        match self {
            Student::Regression(student) => student.buffers(),
            // As `Replay::sample_evenly` draws them.
            Student::Pvp(_) => &[Buffer::Expert, Buffer::Learner],
            Student::Ppl(student) => student.buffers(),
        }
    }

    /// The values it keeps from its start, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        match self {
            Student::Regression(student) => student.begun_with(),
            Student::Pvp(student) => student.begun_with(),
            Student::Ppl(student) => student.begun_with(),
        }
    }

    /// The present policy.
    pub fn policy(&self) -> &Network {
        match self {
            Student::Regression(student) => student.policy(),
            Student::Pvp(student) => student.policy(),
            Student::Ppl(student) => student.policy(),
        }
    }
}

/// Compares gradients with central differences of a loss. `loss(k, by)` returns the
/// loss with number k changed by `by`.
#[cfg(test)]
fn assert_gradients(gradients: &[f32], what: &str, mut loss: impl FnMut(usize, f32) -> f32) {
    const EPSILON: f32 = 5e-3;
    /// Relative to the largest gradient: the error left by f32 and by the curvature.
    const TOLERANCE: f32 = 5e-3;
    let largest = gradients
        .iter()
        .fold(0.0_f32, |most, gradient| most.max(gradient.abs()));
    assert!(largest > 0.0, "{what}: all gradients are zero");
    for (k, &gradient) in gradients.iter().enumerate() {
        let difference = (loss(k, EPSILON) - loss(k, -EPSILON)) / (2.0 * EPSILON);
        let error = (difference - gradient).abs() / largest;
        assert!(
            error < TOLERANCE,
            "{what}, number {k}: {gradient}, by differences {difference}"
        );
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_xoshiro::Xoshiro256PlusPlus;

    use super::*;
    use crate::network::Tape;

    #[test]
    #[should_panic(expected = "a step without a backward pass")]
    fn a_step_needs_a_gradient() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
        Learned::new(&[3, 2], Head::Linear, Rate::constant(1e-3), &mut random).step(1, None);
    }

    /// With more parameters than one thread takes at a time, and more rows than one part has.
    #[test]
    fn any_number_of_threads_steps_to_the_same_bits() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
        let begun = Learned::new(
            &[100, 200, 2],
            Head::Tanh,
            Rate::constant(1e-3),
            &mut random,
        );
        assert!(begun.network.parameters().len() > 2 * CHUNK);
        let states: Vec<f32> = (0..300 * 100).map(|k| (k % 17) as f32 * 0.05).collect();
        let delta: Vec<f32> = (0..300 * 2).map(|k| (k % 5) as f32 * 0.1 - 0.2).collect();
        let learnt = |threads: usize| {
            let (mut own, mut follower) = (begun.clone(), begun.network.clone());
            let mut tape = Tape::default();
            for _ in 0..3 {
                own.network.forward(&states, threads, &mut tape);
                let gradient = Some(&mut own.gradient);
                let pass = (&states[..], &delta[..]);
                own.network
                    .backward(pass, threads, &mut tape, gradient, None);
                // The same step in one piece.
                let (mut plain, mut adam) = (own.network.clone(), own.adam.clone());
                adam.step(plain.parameters_mut(), &own.gradient);
                let mut followed = follower.clone();
                follow(followed.parameters_mut(), plain.parameters(), 0.1);
                own.step(threads, Some((&mut follower, 0.1)));
                assert_eq!((&own.network, &own.adam), (&plain, &adam));
                assert_eq!(follower, followed);
            }
            (own, follower)
        };
        let one = learnt(1);
        assert_ne!(one.0.network, begun.network);
        for threads in [2, 3] {
            assert!(learnt(threads) == one, "{threads} threads");
        }
    }
}
