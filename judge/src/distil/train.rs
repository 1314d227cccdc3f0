//! The training of a distilled judge: several small nets from different beginnings.

use gate::distilled::{INPUTS, OUTPUTS, probabilities};
use learner::adam::{Adam, Rate};
use learner::network::{Head, Network, Tape};
use policy::{Activation, Layer};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use shm_config::draw::Draw;

use super::samples::{Label, Learn, Sample};
use super::split::Split;

/// Neurons of the two hidden layers.
const HIDDEN: [usize; 2] = [48, 32];
/// Questions of an update.
const BATCH: usize = 128;
/// Learning rate at the beginning; it falls to 0 along a cosine.
const RATE: f32 = 2e-3;
/// What the weights lose in each update, in learning rates: 0.02 holds nets of 7,000
/// weights near zero where a few thousand questions say nothing.
const DECAY: f32 = 0.02;
/// Passes over the questions after which the best net was not beaten, and the training
/// ends.
const PATIENCE: usize = 12;
/// A likelihood is at least this, so that its logarithm is a number.
const LEAST: f64 = 1e-9;

/// How a distilled judge is trained.
#[derive(Debug, Clone, Copy)]
pub struct Schedule {
    /// What it learns.
    pub learn: Learn,
    /// Nets, whose probabilities are averaged.
    pub members: usize,
    /// Most passes over the questions.
    pub epochs: usize,
    /// Seed of all draws.
    pub seed: u64,
}

/// A question's index among the samples, and its label.
type Labelled = (usize, Label);

/// Trains the members one after the other; `passed` is called after each pass over the
/// questions.
pub fn train(
    samples: &[Sample],
    split: &Split,
    schedule: &Schedule,
    mut passed: impl FnMut(usize),
) -> Vec<Network> {
    let labelled = |indices: &[usize]| -> Vec<Labelled> {
        let label = |index: &usize| Some((*index, samples[*index].label(schedule.learn)?));
        indices.iter().filter_map(label).collect()
    };
    let (learn, stop) = (labelled(&split.learn), labelled(&split.stop));
    (0..schedule.members)
        .map(|member| {
            let seed = schedule.seed.wrapping_mul(1000).wrapping_add(member as u64);
            Member::new(seed, schedule.epochs).learn(samples, (&learn, &stop), || passed(1))
        })
        .collect()
}

struct Member {
    network: Network,
    adam: Adam,
    draw: Draw,
    epochs: usize,
    batch: Batch,
}

#[derive(Default)]
struct Batch {
    inputs: Vec<f32>,
    delta: Vec<f32>,
    gradient: Vec<f32>,
    tape: Tape,
}

impl Member {
    fn new(seed: u64, epochs: usize) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let sizes = [INPUTS, HIDDEN[0], HIDDEN[1], OUTPUTS];
        let network = Network::new(&sizes, Head::Linear, &mut random);
        Self {
            adam: Adam::new(network.parameters().len(), Rate::constant(RATE)),
            network,
            draw: Draw::new(seed ^ 0x006f_7264_6572),
            epochs,
            batch: Batch::default(),
        }
    }

    /// The net of the pass with the least loss on `stop`.
    fn learn(
        mut self,
        samples: &[Sample],
        (learn, stop): (&[Labelled], &[Labelled]),
        mut passed: impl FnMut(),
    ) -> Network {
        let mut order = learn.to_vec();
        let mut best = (f64::INFINITY, self.network.clone());
        let mut since = 0;
        for epoch in 0..self.epochs {
            let share = epoch as f32 / self.epochs as f32;
            self.adam.rate.start = RATE * 0.5 * (1.0 + (std::f32::consts::PI * share).cos());
            for at in (1..order.len()).rev() {
                order.swap(at, self.draw.below(at as u64 + 1) as usize);
            }
            for batch in order.chunks(BATCH) {
                self.update(samples, batch);
            }
            passed();
            let loss = loss(&self.network, samples, stop);
            since += 1;
            if loss < best.0 {
                best = (loss, self.network.clone());
                since = 0;
            }
            if since >= PATIENCE {
                (epoch + 1..self.epochs).for_each(|_| passed());
                break;
            }
        }
        best.1
    }

    fn update(&mut self, samples: &[Sample], batch: &[Labelled]) {
        let Batch {
            inputs,
            delta,
            gradient,
            tape,
        } = &mut self.batch;
        inputs.clear();
        for (index, _) in batch {
            let sample = &samples[*index];
            // A mirrored scene has the same answer.
            let rows = match self.draw.one_in(2) {
                true => &sample.seen,
                false => &sample.mirrored,
            };
            rows.iter().for_each(|row| inputs.extend_from_slice(row));
        }
        let outputs = self.network.forward(&*inputs, 1, tape);
        delta.clear();
        for (pair, (_, label)) in pairs(outputs).zip(batch) {
            let slopes = slopes(pair, *label);
            let scale = 1.0 / batch.len() as f64;
            delta.extend(
                slopes
                    .as_flattened()
                    .iter()
                    .map(|slope| (slope * scale) as f32),
            );
        }
        let pass = (&inputs[..], &delta[..]);
        self.network.backward(pass, 1, tape, Some(gradient), None);
        let keep = 1.0 - self.adam.rate.start * DECAY;
        let parameters = self.network.parameters_mut();
        parameters
            .iter_mut()
            .for_each(|parameter| *parameter *= keep);
        self.adam.step(parameters, gradient);
    }
}

/// The outputs for each question: for the expert's proposal and for the policy's.
pub fn pairs(outputs: &[f32]) -> impl Iterator<Item = [[f32; OUTPUTS]; 2]> {
    let rows = outputs.as_chunks::<OUTPUTS>().0;
    rows.as_chunks::<2>().0.iter().copied()
}

/// The likelihood of the answers that count as right.
pub(super) fn likelihood(shares: [f64; 3], label: Label) -> f64 {
    let right = shares.iter().zip(label.0).filter(|(_, is_right)| *is_right);
    right.map(|(share, _)| share).sum::<f64>().max(LEAST)
}

/// The gradient of the loss of one question, minus the logarithm of the likelihood, by
/// the outputs of both proposals.
fn slopes(outputs: [[f32; OUTPUTS]; 2], label: Label) -> [[f64; OUTPUTS]; 2] {
    let shares = probabilities(outputs, 1.0);
    let right = likelihood(shares, label);
    let by_score: [f64; 3] = std::array::from_fn(|k| match label.0[k] {
        true => shares[k] - shares[k] / right,
        false => shares[k],
    });
    let ahead = by_score[0] - by_score[1];
    [[ahead, by_score[2]], [-ahead, by_score[2]]]
}

/// The mean loss of these questions; 0 without any.
fn loss(network: &Network, samples: &[Sample], of: &[Labelled]) -> f64 {
    let mut inputs = Vec::with_capacity(of.len() * 2 * INPUTS);
    for (index, _) in of {
        let rows = &samples[*index].seen;
        rows.iter().for_each(|row| inputs.extend_from_slice(row));
    }
    let mut tape = Tape::default();
    let outputs = network.forward(&inputs, 1, &mut tape);
    let losses = pairs(outputs).zip(of);
    let sum: f64 = losses
        .map(|(pair, (_, label))| -likelihood(probabilities(pair, 1.0), *label).ln())
        .sum();
    sum / of.len().max(1) as f64
}

/// The members as one chain of layers: the first layer sees the same inputs, the others
/// only their own member's.
pub fn joined(members: &[Network]) -> Vec<Layer> {
    let count = members.first().map_or(0, |network| network.layers().len());
    (0..count)
        .map(|k| {
            let layers: Vec<_> = members
                .iter()
                .filter_map(|network| network.layers().nth(k))
                .collect();
            let is_first = k == 0;
            let inputs = match is_first {
                true => INPUTS,
                false => layers.iter().map(|layer| layer.inputs).sum(),
            };
            let mut weights = Vec::new();
            let mut bias = Vec::new();
            let mut before = 0;
            for layer in &layers {
                let own = layer.inputs;
                for row in layer.weights.chunks_exact(own) {
                    let mut whole = vec![0.0; inputs];
                    whole[before..before + own].copy_from_slice(row);
                    weights.extend(whole);
                }
                bias.extend_from_slice(layer.bias);
                before += if is_first { 0 } else { own };
            }
            Layer {
                inputs,
                outputs: bias.len(),
                weights,
                bias,
                activation: match k + 1 == count {
                    true => Activation::None,
                    false => Activation::Relu,
                },
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gradient_is_that_of_finite_differences() {
        let labels = [
            Label([true, false, false]),
            Label([false, true, false]),
            Label([false, false, true]),
            Label([false, true, true]),
        ];
        let outputs = [[0.4_f32, -0.2], [-0.7, 0.9]];
        for label in labels {
            let slopes = slopes(outputs, label);
            for (party, of) in slopes.iter().enumerate() {
                for (k, slope) in of.iter().enumerate() {
                    let loss = |by: f32| {
                        let mut moved = outputs;
                        moved[party][k] += by;
                        -likelihood(probabilities(moved, 1.0), label).ln()
                    };
                    let difference = (loss(1e-2) - loss(-1e-2)) / 2e-2;
                    assert!(
                        (slope - difference).abs() < 1e-4,
                        "{label:?} {slope} {difference}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_joined_members_answer_as_each_of_them() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
        let members: Vec<_> = (0..3)
            .map(|_| Network::new(&[INPUTS, 5, 4, OUTPUTS], Head::Linear, &mut random))
            .collect();
        let shape = policy::Shape {
            inputs: INPUTS,
            outputs: 3 * OUTPUTS,
        };
        let mut chain = policy::Chain::new(joined(&members), shape).expect("a chain");
        let row: Vec<f32> = (0..INPUTS).map(|k| (k as f32 * 0.37).sin()).collect();
        let together = chain.infer(&row).to_vec();
        for (member, own) in members.iter().zip(together.chunks(OUTPUTS)) {
            let mut tape = Tape::default();
            let alone = member.forward(&row, 1, &mut tape);
            for (own, alone) in own.iter().zip(alone) {
                assert!((own - alone).abs() < 1e-5, "{own} {alone}");
            }
        }
    }
}
