//! The ways to learn, one file each, hyper-parameters at the top with their
//! source.
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
use shm_config::message::FEATURES;

use crate::Adam;
use crate::network::{Head, Network};
use crate::replay::{ACTIONS, Replay};

pub use ppl::Ppl;
pub use pvp::Pvp;
pub use regression::{Regression, Source};

/// What the algorithms have in common.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Size {
    /// Neurons of each of the two hidden layers.
    pub hidden: usize,
    /// Transitions of an update.
    pub batch: usize,
}

impl Size {
    /// By configuration key, with the length of Adam's steps.
    fn begun_with(self, rate: f32) -> Vec<(&'static str, f64)> {
        vec![
            ("learner.hidden", self.hidden as f64),
            ("learner.batch", self.batch as f64),
            ("learner.rate", f64::from(rate)),
        ]
    }
}

/// What an update cost; zeros for what an algorithm has not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Of the actor, imitation included.
    pub actor: f32,
    /// Of the imitation alone.
    pub imitation: f32,
    /// Of the critics.
    pub critic: f32,
}

/// A network and its optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Learned {
    /// The network.
    pub network: Network,
    /// Its optimiser.
    pub adam: Adam,
    gradient: Vec<f32>,
}

impl Learned {
    /// Initialised at random.
    pub fn new(sizes: &[usize], head: Head, rate: f32, random: &mut impl Rng) -> Learned {
        let network = Network::new(sizes, head, random);
        let count = network.parameters().len();
        Learned {
            network,
            adam: Adam::new(count, rate),
            gradient: vec![0.0; count],
        }
    }

    /// One step of the optimiser along the gradient gathered; it is empty after.
    fn step(&mut self) {
        self.adam
            .step(self.network.parameters_mut(), &self.gradient);
        self.gradient.fill(0.0);
    }
}

/// An actor of the experiment's size: 259-256-256-2 by default.
pub fn actor(size: Size, rate: f32, random: &mut impl Rng) -> Learned {
    let sizes = [FEATURES, size.hidden, size.hidden, ACTIONS];
    Learned::new(&sizes, Head::Tanh, rate, random)
}

/// Who learns: networks, optimisers and what else outlives an update.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Student {
    /// By imitation.
    Regression(Regression),
    /// By proxy values.
    Pvp(Box<Pvp>),
    /// By pairs at predicted states.
    Ppl(Ppl),
}

impl Student {
    /// One update from the replay, on at most this many threads, whose number
    /// changes no bit of it; nothing when it holds nothing to learn from.
    pub fn update(&mut self, replay: &Replay, random: &mut impl Rng, threads: usize) -> Losses {
        match self {
            Student::Regression(student) => student.update(replay, random, threads),
            Student::Pvp(student) => student.update(replay, random, threads),
            Student::Ppl(student) => student.update(replay, random, threads),
        }
    }

    /// What it was begun with, by configuration key.
    pub fn begun_with(&self) -> Vec<(&'static str, f64)> {
        match self {
            Student::Regression(student) => student.begun_with(),
            Student::Pvp(student) => student.begun_with(),
            Student::Ppl(student) => student.begun_with(),
        }
    }

    /// The policy as it is now.
    pub fn policy(&self) -> &Network {
        match self {
            Student::Regression(student) => student.policy(),
            Student::Pvp(student) => student.policy(),
            Student::Ppl(student) => student.policy(),
        }
    }
}

/// Compares slopes with central differences of a loss, which is given back with
/// number k moved by a little.
#[cfg(test)]
fn assert_slopes(slopes: &[f32], what: &str, mut loss: impl FnMut(usize, f32) -> f32) {
    const EPSILON: f32 = 5e-3;
    /// Of the largest slope: what f32 and the curvature leave.
    const TOLERANCE: f32 = 5e-3;
    let largest = slopes
        .iter()
        .fold(0.0_f32, |most, slope| most.max(slope.abs()));
    assert!(largest > 0.0, "{what}: no slope at all");
    for (k, &slope) in slopes.iter().enumerate() {
        let difference = (loss(k, EPSILON) - loss(k, -EPSILON)) / (2.0 * EPSILON);
        let error = (difference - slope).abs() / largest;
        assert!(
            error < TOLERANCE,
            "{what}, number {k}: {slope}, by differences {difference}"
        );
    }
}
