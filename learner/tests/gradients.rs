//! Compares every gradient of a network with finite differences.
//!
//! The gradients of the losses are tested in `src/algorithm`.

use learner::network::{Head, Network, Tape};
use learner::windows::Windows;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;

const SIZES: [usize; 4] = [5, 8, 7, 3];
const BATCH: usize = 6;
/// Finite difference: small enough that few ReLUs change sides, large enough for f32.
const EPSILON: f32 = 2e-3;
/// Tolerance relative to the largest gradient: what f32 and the curvature leave.
const TOLERANCE: f64 = 5e-3;
/// At most this share of the gradients may be wrong because a ReLU changes sides within
/// epsilon.
const KINKS: f64 = 0.1;

/// Two convolutions that pass on one number: four windows of three numbers around a circle,
/// and two of four answers.
fn convolutions() -> Vec<(Windows, usize)> {
    let windows = |window: usize, indices: &[u32]| Windows {
        kept: 1,
        window,
        indices: indices.to_vec(),
    };
    vec![
        (windows(3, &[4, 1, 2, 1, 2, 3, 2, 3, 4, 3, 4, 1]), 2),
        (windows(4, &[1, 2, 3, 4, 5, 6, 7, 8]), 3),
    ]
}

struct Case {
    network: Network,
    inputs: Vec<f32>,
    /// The loss is the sum of the outputs with these weights.
    weights: Vec<f32>,
}

impl Case {
    fn new(head: Head, seed: u64) -> Case {
        Case::of(head, seed, BATCH)
    }

    fn of(head: Head, seed: u64, batch: usize) -> Case {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let before = match seed % 2 {
            0 => Vec::new(),
            _ => convolutions(),
        };
        let network = Network::convolved(before, &SIZES, head, &mut random);
        let mut numbers = |count: usize| -> Vec<f32> {
            (0..count).map(|_| random.random_range(-1.0..1.0)).collect()
        };
        Case {
            network,
            inputs: numbers(batch * SIZES[0]),
            weights: numbers(batch * SIZES[3]),
        }
    }

    fn loss(&self) -> f64 {
        let mut tape = Tape::default();
        let outputs = self.network.forward(&self.inputs, 1, &mut tape);
        let terms = outputs.iter().zip(&self.weights);
        terms.map(|(&y, &w)| f64::from(y) * f64::from(w)).sum()
    }

    /// Gradients of the parameters and of the inputs, with this many threads.
    fn gradients(&self, threads: usize) -> (Vec<f32>, Vec<f32>) {
        let mut tape = Tape::default();
        self.network.forward(&self.inputs, threads, &mut tape);
        let mut parameters = vec![0.0; self.network.parameters().len()];
        let mut inputs = Vec::new();
        self.network.backward(
            (&self.inputs, &self.weights),
            threads,
            &mut tape,
            Some(&mut parameters),
            Some(&mut inputs),
        );
        (parameters, inputs)
    }
}

/// Compares gradients with finite differences; `change` moves number k by a little.
fn assert_gradients(
    gradients: &[f32],
    case: &mut Case,
    change: impl Fn(&mut Case, usize, f32),
    what: &str,
) {
    let largest = gradients
        .iter()
        .fold(0.0_f32, |largest, gradient| largest.max(gradient.abs()));
    assert!(largest > 0.0, "{what}: all gradients are zero");
    let mut wrong = Vec::new();
    for (k, &gradient) in gradients.iter().enumerate() {
        change(case, k, EPSILON);
        let above = case.loss();
        change(case, k, -2.0 * EPSILON);
        let below = case.loss();
        change(case, k, EPSILON);
        let difference = (above - below) / (2.0 * f64::from(EPSILON));
        let error = (difference - f64::from(gradient)).abs();
        if error > TOLERANCE * f64::from(largest) {
            wrong.push((k, gradient, difference));
        }
    }
    let share = wrong.len() as f64 / gradients.len() as f64;
    assert!(
        share <= KINKS,
        "{what}: (number, gradient, finite difference) {wrong:?}"
    );
}

#[test]
fn slopes_of_parameters_and_inputs_are_those_of_finite_differences() {
    for head in [Head::Linear, Head::Tanh] {
        for seed in 0..5 {
            let mut case = Case::new(head, seed);
            let (parameters, inputs) = case.gradients(1);
            let what = format!("{head:?}, seed {seed}");
            assert_gradients(
                &parameters,
                &mut case,
                |case, k, by| case.network.parameters_mut()[k] += by,
                &format!("{what}, parameters"),
            );
            assert_gradients(
                &inputs,
                &mut case,
                |case, k, by| case.inputs[k] += by,
                &format!("{what}, inputs"),
            );
        }
    }
}

#[test]
fn a_pass_back_adds_to_the_gradient_that_is_there() {
    let case = Case::new(Head::Tanh, 1);
    let (once, _) = case.gradients(1);
    let mut tape = Tape::default();
    case.network.forward(&case.inputs, 1, &mut tape);
    let mut twice = once.clone();
    let pass = (&case.inputs[..], &case.weights[..]);
    case.network
        .backward(pass, 1, &mut tape, Some(&mut twice), None);
    for (twice, once) in twice.iter().zip(&once) {
        assert!((twice - 2.0 * once).abs() <= 1e-5 * (1.0 + once.abs()));
    }
}

#[test]
fn slopes_of_the_inputs_do_not_need_those_of_the_parameters() {
    let case = Case::new(Head::Linear, 2);
    let (_, expected) = case.gradients(1);
    let mut tape = Tape::default();
    case.network.forward(&case.inputs, 1, &mut tape);
    let mut inputs = Vec::new();
    let pass = (&case.inputs[..], &case.weights[..]);
    case.network
        .backward(pass, 1, &mut tape, None, Some(&mut inputs));
    assert_eq!(inputs, expected);
}

#[test]
fn any_number_of_threads_gives_the_same_gradients_to_the_last_bit() {
    // Many parts of a batch, the last of them short.
    for seed in [2, 3] {
        let case = Case::of(Head::Tanh, seed, 1001);
        let one = case.gradients(1);
        for threads in [0, 2, 3] {
            assert_eq!(case.gradients(threads), one, "{threads} threads");
        }
    }
}

#[test]
fn a_batch_in_parts_has_the_gradients_of_its_rows() {
    let case = Case::of(Head::Linear, 5, 301);
    let (whole, inputs) = case.gradients(1);
    let mut tape = Tape::default();
    let mut sum = vec![0.0; whole.len()];
    let mut each = Vec::new();
    for (input, weight) in case
        .inputs
        .chunks(SIZES[0])
        .zip(case.weights.chunks(SIZES[3]))
    {
        case.network.forward(input, 1, &mut tape);
        let mut gradient = Vec::new();
        let pass = (input, weight);
        case.network
            .backward(pass, 1, &mut tape, Some(&mut sum), Some(&mut gradient));
        each.extend(gradient);
    }
    let rows = whole.iter().zip(&sum).chain(inputs.iter().zip(&each));
    for (whole, rows) in rows {
        assert!(
            (whole - rows).abs() <= 1e-4 * (1.0 + rows.abs()),
            "{whole} and {rows}"
        );
    }
}

#[test]
fn a_tape_may_be_used_again_for_a_batch_of_another_size() {
    let case = Case::new(Head::Tanh, 7);
    let (expected, _) = case.gradients(1);
    let mut tape = Tape::default();
    let larger = [&case.inputs[..], &case.inputs, &case.inputs].concat();
    case.network.forward(&larger, 1, &mut tape);
    let weights = [&case.weights[..], &case.weights, &case.weights].concat();
    let mut gradient = vec![0.0; expected.len()];
    case.network
        .backward((&larger, &weights), 1, &mut tape, Some(&mut gradient), None);
    case.network.forward(&case.inputs, 1, &mut tape);
    gradient.fill(0.0);
    let pass = (&case.inputs[..], &case.weights[..]);
    case.network
        .backward(pass, 1, &mut tape, Some(&mut gradient), None);
    assert_eq!(gradient, expected);
}
