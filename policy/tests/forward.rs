//! The net over the caller's memory answers as the one that owns its own.

use policy::{Activation, BLOCK, Compression, Forward, Layer, Mismatch, Mlp, PackedLayer, pack};
use proptest::prelude::*;
use shm_config::message::FEATURES;

type Blocks = Vec<[f32; BLOCK]>;

fn layer(inputs: usize, outputs: usize, activation: Activation) -> Layer {
    let number = |k: usize| ((k * 37 % 101) as f32 - 50.0) / 500.0;
    Layer {
        weights: (0..inputs * outputs).map(number).collect(),
        bias: (0..outputs).map(number).collect(),
        inputs,
        outputs,
        activation,
    }
}

fn packed(layer: &Layer) -> PackedLayer<Blocks> {
    let count = PackedLayer::<()>::block_count(layer.inputs, layer.outputs);
    let mut blocks = vec![[0.0; BLOCK]; count];
    pack(&layer.weights, &layer.bias, &mut blocks).expect("the lengths fit");
    let shape = [layer.inputs, layer.outputs];
    PackedLayer::packed(blocks, shape, layer.activation).expect("the blocks fit")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]
    #[test]
    fn both_answer_the_same_bits(hidden in 1..200usize, slope in 0.0..40.0f32, seen in prop::collection::vec(0.0..1.0f32, FEATURES)) {
        let layers = vec![
            layer(FEATURES, hidden, Activation::Relu),
            layer(hidden, 2, Activation::Tanh),
        ];
        let borrowed: Vec<_> = layers.iter().map(packed).collect();
        let (mut x, mut y) = (vec![0.0; 259], vec![0.0; 259]);
        let by = Compression { from: 19, to: 259, slope };
        let forward = Forward::new(&borrowed, [&mut x, &mut y]).expect("a net");
        let mut forward = forward.compressed(by);
        let mut owned = Mlp::compressed(by, layers).expect("a net");
        let [ours, theirs] = [forward.infer(&seen), owned.infer(&seen)];
        prop_assert_eq!(ours.map(f32::to_bits), theirs.map(f32::to_bits));
        prop_assert!(ours[0] != 0.0);
    }
}

#[test]
fn no_compression_changes_no_bit_of_any_number() {
    let mut numbers = [
        0.0,
        -0.0,
        1e-40,
        -3.5,
        f32::MAX,
        f32::INFINITY,
        f32::NEG_INFINITY,
    ];
    let before = numbers.map(f32::to_bits);
    Compression::default().apply(&mut numbers);
    assert_eq!(numbers.map(f32::to_bits), before);
}

#[test]
fn what_is_no_net_is_refused() {
    let (first, last) = (
        layer(FEATURES, 8, Activation::Relu),
        layer(8, 2, Activation::Tanh),
    );
    let refusal = |layers: &[&Layer], row: usize| {
        let layers: Vec<_> = layers.iter().map(|layer| packed(layer)).collect();
        let (mut x, mut y) = (vec![0.0; row], vec![0.0; row]);
        Forward::new(&layers, [&mut x, &mut y]).err()
    };
    assert_eq!(refusal(&[&first, &last], FEATURES), None);
    assert_eq!(refusal(&[], FEATURES), Some(Mismatch::Count));
    assert_eq!(refusal(&[&first; 17], 300), Some(Mismatch::Count));
    assert_eq!(refusal(&[&last], FEATURES), Some(Mismatch::Chain(0)));
    assert_eq!(refusal(&[&first], FEATURES), Some(Mismatch::Chain(0)));
    assert_eq!(
        refusal(&[&first, &first], FEATURES),
        Some(Mismatch::Chain(1))
    );
    assert_eq!(refusal(&[&first, &last], 258), Some(Mismatch::Workspace));
    let mut blocks = [[0.0; BLOCK]; 3];
    assert_eq!(pack(&[1.0; 4], &[], &mut blocks), Err(Mismatch::Layer));
    assert_eq!(
        pack(&[1.0; 5], &[0.0; 2], &mut blocks),
        Err(Mismatch::Layer)
    );
    assert_eq!(
        pack(&[1.0; 4], &[0.0; 2], &mut blocks[1..]),
        Err(Mismatch::Layer)
    );
    assert_eq!(pack(&[1.0; 4], &[0.0; 2], &mut blocks), Ok(()));
}
