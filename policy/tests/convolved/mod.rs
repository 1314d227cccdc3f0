//! A net with convolutions over the scan.

use policy::{Activation, Compression, Layer, Mlp, Windows};

/// A convolution over the beams, which passes on the ego's features.
pub fn over_beams(window: usize, filters: usize) -> Windows {
    let around = |beam: usize| (beam..beam + window).map(|k| (19 + k % 240) as u32);
    Windows {
        inputs: 259,
        kept: 19,
        window,
        indices: (0..240).step_by(4).flat_map(around).collect(),
        weights: (0..filters * window)
            .map(|k| ((k * 7 % 11) as f32 - 5.0) * 0.02)
            .collect(),
        bias: (0..filters).map(|k| k as f32 * 0.01).collect(),
    }
}

/// A net of two convolutions and one layer.
pub fn convolved() -> Mlp {
    let first = over_beams(9, 3);
    let second = Windows {
        inputs: first.outputs(),
        kept: 2,
        window: 6,
        indices: (19..19 + 180).collect(),
        weights: (0..12).map(|k| (k as f32 - 6.0) * 0.1).collect(),
        bias: vec![0.1, -0.1],
    };
    let inputs = second.outputs();
    let layer = Layer {
        weights: (0..2 * inputs)
            .map(|k| ((k % 13) as f32 - 6.0) * 0.02)
            .collect(),
        bias: vec![0.0, 0.1],
        inputs,
        outputs: 2,
        activation: Activation::Tanh,
    };
    let compression = Compression {
        from: 19,
        to: 259,
        slope: 20.0,
    };
    Mlp::convolved(compression, vec![first, second], vec![layer]).expect("a net")
}
