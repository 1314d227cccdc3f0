//! A good policy file and the ten kinds of bad ones, made from it byte by byte.

use policy::{Activation, Layer, Mlp, Provenance};

/// A weight that occurs once, to be found in the bytes.
const MARK: f32 = 0.123_456_7;

/// A net of 259-`hidden`-`hidden`-2 with small weights out of `seed`.
pub fn net(hidden: usize, seed: u64) -> Mlp {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = |scale: f32| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        ((state >> 40) as f32 / (1_u64 << 23) as f32 - 1.0) * scale
    };
    let mut layer = |inputs: usize, outputs: usize, activation| {
        let scale = 1.0 / (inputs as f32).sqrt();
        Layer {
            weights: (0..inputs * outputs).map(|_| next(scale)).collect(),
            bias: (0..outputs).map(|_| next(scale)).collect(),
            inputs,
            outputs,
            activation,
        }
    };
    let mut layers = vec![
        layer(259, hidden, Activation::Relu),
        layer(hidden, hidden, Activation::Relu),
        layer(hidden, 2, Activation::Tanh),
    ];
    layers[0].weights[77] = MARK;
    Mlp::new(layers).expect("a net of the right shape")
}

/// Two probes that use the marked weight.
pub fn probes() -> Vec<Vec<f32>> {
    let ramp = (0..259).map(|k| k as f32 / 259.0).collect();
    vec![vec![0.25; 259], ramp]
}

/// A good file.
pub fn good(hidden: usize, seed: u64) -> Vec<u8> {
    let provenance = Provenance {
        algorithm: "test".into(),
        seed,
        steps: 1000,
        commit: "0123abcd".into(),
    };
    policy::encode(&net(hidden, seed), &provenance, &probes())
}

/// `bytes` with every `old` replaced by `new`, of the same length.
pub fn patched(bytes: &[u8], old: &[u8], new: &[u8]) -> Vec<u8> {
    assert_eq!(old.len(), new.len());
    let mut out = bytes.to_vec();
    let mut found = 0;
    for at in 0..out.len().saturating_sub(old.len()) {
        if out[at..].starts_with(old) {
            out[at..at + old.len()].copy_from_slice(new);
            found += 1;
        }
    }
    assert!(found > 0, "there is something to replace");
    out
}

/// Every kind of bad file that is small, with a word of its reason.
pub fn bad(good: &[u8]) -> Vec<(&'static str, Vec<u8>, &'static str)> {
    let layout = format!("{:016x}", shm_config::message::OBSERVATION_LAYOUT);
    let mark = MARK.to_le_bytes();
    vec![
        ("truncated", good[..good.len() / 2].to_vec(), "truncated"),
        (
            "wrong_shape",
            // A dimension of 259 in protobuf's words, and of 258.
            patched(good, &[0x08, 0x83, 0x02], &[0x08, 0x82, 0x02]),
            "wrong shape",
        ),
        (
            "nan_weights",
            patched(good, &mark, &f32::NAN.to_le_bytes()),
            "not finite",
        ),
        (
            "wrong_layout",
            patched(good, layout.as_bytes(), b"0000000000000001"),
            "wrong observation layout",
        ),
        (
            "unknown_operator",
            patched(good, b"Relu", b"Loop"),
            "unknown operator Loop",
        ),
        ("empty", Vec::new(), "empty"),
        (
            "not_onnx",
            b"PK\x03\x04 a zip archive, as PyTorch saves".to_vec(),
            "not an ONNX file",
        ),
        (
            "probe_mismatch",
            patched(good, &mark, &5.0_f32.to_le_bytes()),
            "probe",
        ),
    ]
}
