//! Compares every gradient of a network with finite differences.
//!
//! The gradients of the losses are tested in `src/algorithm`.

use learner::input::{Groups, Input};
use learner::network::{Head, Network, ROWS, Tape};
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
        let mut parameters = Vec::new();
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
fn a_pass_back_replaces_the_gradient_that_is_there() {
    let case = Case::new(Head::Tanh, 1);
    let (once, _) = case.gradients(1);
    let mut tape = Tape::default();
    case.network.forward(&case.inputs, 1, &mut tape);
    for before in [once.clone(), vec![7.0; 3], Vec::new()] {
        let mut again = before;
        let pass = (&case.inputs, &case.weights[..]);
        case.network
            .backward(pass, 1, &mut tape, Some(&mut again), None);
        assert_eq!(again, once);
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
        let (mut gradient, mut of_input) = (Vec::new(), Vec::new());
        let wanted = (Some(&mut gradient), Some(&mut of_input));
        let pass = (input, weight);
        case.network
            .backward(pass, 1, &mut tape, wanted.0, wanted.1);
        each.extend(of_input);
        sum.iter_mut()
            .zip(gradient)
            .for_each(|(sum, slope)| *sum += slope);
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
    let mut gradient = Vec::new();
    case.network
        .backward((&larger, &weights), 1, &mut tape, Some(&mut gradient), None);
    case.network.forward(&case.inputs, 1, &mut tape);
    let pass = (&case.inputs[..], &case.weights[..]);
    case.network
        .backward(pass, 1, &mut tape, Some(&mut gradient), None);
    assert_eq!(gradient, expected);
}

/// Groups of rows of a network without convolutions.
struct Grouped {
    case: Case,
    /// Numbers that the rows of a group have in common.
    begin: usize,
    common: Vec<f32>,
    own: Vec<f32>,
    rows: Vec<usize>,
}

impl Grouped {
    fn new(groups: usize, begin: usize) -> Grouped {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(4);
        // Some groups have no row at all.
        let rows: Vec<usize> = (0..groups).map(|k| [1, 3, 0, 2][k % 4]).collect();
        let batch = rows.iter().sum();
        let mut numbers = |count: usize| -> Vec<f32> {
            (0..count).map(|_| random.random_range(-1.0..1.0)).collect()
        };
        Grouped {
            begin,
            common: numbers(groups * begin),
            own: numbers(batch * (SIZES[0] - begin)),
            case: Case::of(Head::Tanh, 2, batch),
            rows,
        }
    }

    fn groups(&self) -> Groups<'_> {
        Groups {
            common: &self.common,
            own: &self.own,
            rows: &self.rows,
        }
    }

    /// The same rows without groups.
    fn plain(&self) -> Vec<f32> {
        let (begin, own) = (self.begin, SIZES[0] - self.begin);
        let groups = self.rows.iter().enumerate();
        let groups = groups.flat_map(|(group, rows)| vec![group; *rows]);
        let rows = groups.enumerate().map(|(row, group)| {
            let common = &self.common[group * begin..(group + 1) * begin];
            [common, &self.own[row * own..(row + 1) * own]].concat()
        });
        rows.flatten().collect()
    }

    /// Outputs, gradients of the parameters, and of the inputs.
    fn pass<'a>(&self, inputs: impl Into<Input<'a>>, threads: usize) -> [Vec<f32>; 3] {
        let (network, inputs) = (&self.case.network, inputs.into());
        let mut tape = Tape::default();
        let outputs = network.forward(inputs, threads, &mut tape).to_vec();
        let (mut gradient, mut of_inputs) = (Vec::new(), Vec::new());
        let pass = (inputs, &self.case.weights[..]);
        let wanted = (Some(&mut gradient), Some(&mut of_inputs));
        network.backward(pass, threads, &mut tape, wanted.0, wanted.1);
        [outputs, gradient, of_inputs]
    }
}

#[test]
fn groups_of_rows_have_the_outputs_and_gradients_of_their_rows() {
    // In one part, and in several; with nothing in common, and with nothing else.
    for (groups, begin) in [(1, 2), (9, 0), (9, 2), (9, 5), (2 * ROWS + 5, 3)] {
        let grouped = Grouped::new(groups, begin);
        let [outputs, gradient, of_own] = grouped.pass(grouped.groups(), 1);
        let [plain_outputs, plain_gradient, of_inputs] = grouped.pass(&grouped.plain(), 1);
        let of_plain = of_inputs.chunks(SIZES[0]).flat_map(|row| &row[begin..]);
        let pairs = outputs.iter().zip(&plain_outputs);
        let pairs = pairs.chain(gradient.iter().zip(&plain_gradient));
        assert_eq!(of_own.len(), grouped.own.len());
        for (grouped, plain) in pairs.chain(of_own.iter().zip(of_plain)) {
            let off = (grouped - plain).abs();
            assert!(off <= 1e-4 * (1.0 + plain.abs()), "{grouped} and {plain}");
        }
    }
}

#[test]
fn any_number_of_threads_gives_groups_the_same_gradients_to_the_last_bit() {
    let grouped = Grouped::new(5 * ROWS + 3, 2);
    let one = grouped.pass(grouped.groups(), 1);
    for threads in [0, 2, 3] {
        let more = grouped.pass(grouped.groups(), threads);
        assert_eq!(more, one, "{threads} threads");
    }
}

#[test]
fn a_pass_back_over_no_rows_writes_zeros() {
    let case = Case::new(Head::Tanh, 2);
    let mut tape = Tape::default();
    assert!(case.network.forward(&[], 1, &mut tape).is_empty());
    let (mut gradient, mut of_inputs) = (vec![7.0; 3], vec![7.0]);
    let wanted = (Some(&mut gradient), Some(&mut of_inputs));
    let nothing: [f32; 0] = [];
    case.network
        .backward((&nothing, &[]), 1, &mut tape, wanted.0, wanted.1);
    assert_eq!(gradient, vec![0.0; case.network.parameters().len()]);
    assert!(of_inputs.is_empty());
}

#[test]
#[should_panic(expected = "gradients of other rows")]
fn gradients_of_more_rows_than_there_are_are_refused() {
    let case = Case::new(Head::Tanh, 2);
    let mut tape = Tape::default();
    case.network.forward(&case.inputs, 1, &mut tape);
    let weights = [&case.weights[..], &case.weights].concat();
    let pass = (&case.inputs, &weights[..]);
    case.network
        .backward(pass, 1, &mut tape, Some(&mut Vec::new()), None);
}

#[test]
#[should_panic(expected = "a convolution takes no groups of rows")]
fn a_convolution_refuses_groups() {
    let case = Case::new(Head::Tanh, 1);
    let groups = Groups {
        common: &[0.5; 2],
        own: &[0.5; 3],
        rows: &[1],
    };
    case.network.forward(groups, 1, &mut Tape::default());
}

#[test]
#[should_panic(expected = "groups of rows of another size")]
fn groups_with_a_row_too_few_are_refused() {
    let grouped = Grouped::new(9, 2);
    let own = &grouped.own[3..];
    let groups = Groups {
        own,
        ..grouped.groups()
    };
    grouped.pass(groups, 1);
}
