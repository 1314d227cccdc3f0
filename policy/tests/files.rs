//! What is read, and what is refused and why.

mod bad;
mod convolved;
mod torch;

use bad::{bad, good, net, patched};
use convolved::{convolved, over_beams};
use policy::{
    Activation, Compression, Layer, Mlp, Net, Refusal, Windows, check_hash, decode, sha256,
};
use proptest::prelude::*;
use shm_config::message::{
    INPUTS_WITH_MOTION, MOTION_LAYOUT, OBSERVATION_LAYOUT, WEIGHTS_BYTES_MAX,
};

fn reason(bytes: &[u8]) -> String {
    decode(bytes).expect_err("refused").to_string()
}

#[test]
fn what_is_written_is_read_again() {
    let bytes = good(32, 7);
    let file = decode(&bytes).expect("a good file");
    let provenance = file.provenance.expect("ours");
    assert_eq!(provenance.algorithm, "test");
    assert_eq!((provenance.seed, provenance.steps), (7, 1000));
    assert_eq!(file.probes.len(), 2);
    assert_eq!(file.sha256, sha256(&bytes));
    let Net::Mlp { mlp: mut read, .. } = file.net else {
        panic!("a chain of layers");
    };
    let mut written = net(32, 7);
    assert_eq!(*read, written);
    assert_eq!(read.infer(&[0.3; 259]), written.infer(&[0.3; 259]));
}

/// A file of a net behind this compression.
fn compressing(from: usize, slope: f32) -> Vec<u8> {
    let layers = net(8, 7).layers().to_vec();
    let mlp = Mlp::compressed(
        Compression {
            from,
            to: 259,
            slope,
        },
        layers,
    )
    .expect("a net");
    policy::encode(&mlp, &policy::Provenance::default(), &bad::probes())
}

#[test]
fn a_policy_may_take_how_bodies_move() {
    let layer = |inputs: usize, outputs: usize| Layer {
        weights: (0..inputs * outputs)
            .map(|k| (k % 7) as f32 * 1e-3)
            .collect(),
        bias: vec![0.1; outputs],
        inputs,
        outputs,
        activation: Activation::Tanh,
    };
    let compression = Compression {
        from: 19,
        to: 259,
        slope: 20.0,
    };
    let layers = vec![layer(INPUTS_WITH_MOTION, 8), layer(8, 2)];
    let mut mlp = Mlp::compressed(compression, layers).expect("a net");
    assert!(mlp.takes_motion());
    let provenance = policy::Provenance::default();
    let bytes = policy::encode(&mlp, &provenance, &[vec![0.5; INPUTS_WITH_MOTION]]);
    let file = decode(&bytes).expect("a good file");
    let Net::Mlp { mlp: read, names } = file.net else {
        panic!("a chain of layers");
    };
    assert_eq!(*read, mlp);
    assert_eq!(names.input_shape, [1, 379]);
    let mut features = [0.5; INPUTS_WITH_MOTION];
    let resting = mlp.infer(&features);
    features[INPUTS_WITH_MOTION - 1] = 0.9;
    assert_ne!(mlp.infer(&features), resting, "motion counts");

    // The layout of the observation alone is another one.
    let layout = |layout: u64| format!("{layout:016x}").into_bytes();
    let (motion, alone) = (layout(MOTION_LAYOUT), layout(OBSERVATION_LAYOUT));
    let refusal = decode(&bad::patched(&bytes, &motion, &alone)).expect_err("refused");
    assert!(matches!(refusal, Refusal::WrongLayout { .. }), "{refusal}");
}

#[test]
fn a_compression_is_written_and_read_again() {
    for (from, slope) in [(19, 20.0), (0, 0.5), (258, 1e-3)] {
        let file = decode(&compressing(from, slope)).expect("a good file");
        let Net::Mlp { mlp, .. } = file.net else {
            panic!("a chain of layers");
        };
        assert_eq!(
            mlp.compression(),
            Compression {
                from,
                to: 259,
                slope
            }
        );
    }
    let plain = policy::encode(&net(8, 7), &policy::Provenance::default(), &bad::probes());
    for (from, slope) in [(19, 0.0), (259, 20.0), (1000, 20.0)] {
        assert!(
            compressing(from, slope) == plain,
            "{slope} from {from} changes a file"
        );
    }
    for slope in [-1.0, f32::NAN, f32::INFINITY] {
        let layers = net(8, 7).layers().to_vec();
        let refusal = Mlp::compressed(
            Compression {
                from: 0,
                to: 259,
                slope,
            },
            layers,
        )
        .expect_err("refused");
        assert!(refusal.to_string().contains("slope"), "{refusal}");
    }
}

#[test]
fn other_operators_before_the_layers_are_left_to_onnx_runtime() {
    let good = compressing(19, 20.0);
    let plain = patched(&good, b"vlaps.", b"other.");
    let is_native = |bytes: &[u8]| matches!(decode(bytes).expect("read").net, Net::Mlp { .. });
    assert!(is_native(&plain));
    let twenty = 20.0_f32.to_le_bytes();
    let other_slope = {
        let at = plain.windows(4).position(|bytes| bytes == twenty);
        let mut bytes = plain.clone();
        bytes[at.expect("a slope")..][..4].copy_from_slice(&19.0_f32.to_le_bytes());
        bytes
    };
    assert!(!is_native(&other_slope), "two slopes");
    for (old, new) in [("Mul", "Add"), ("Div", "Mul")] {
        let other = patched(&plain, old.as_bytes(), new.as_bytes());
        assert!(!is_native(&other), "{new} in place of {old}");
    }
    // The same division, of something that may be 0, is refused as its answer.
    let negative = patched(&plain, &twenty, &(-20.0_f32).to_le_bytes());
    assert!(reason(&negative).contains("slope"), "{}", reason(&negative));
}

#[test]
fn each_kind_of_bad_file_has_a_reason_of_its_own() {
    let good = good(32, 1);
    let mut reasons: Vec<String> = bad(&good)
        .into_iter()
        .map(|(kind, bytes, word)| {
            let reason = reason(&bytes);
            assert!(reason.contains(word), "{kind}: {reason}");
            println!("{kind}: {reason}");
            reason
        })
        .collect();
    let large = reason(&vec![0x08; WEIGHTS_BYTES_MAX + 1]);
    assert!(large.contains("over the limit"), "{large}");
    reasons.push(large);
    let wrong_hash = check_hash(&good, &[3; 32])
        .expect_err("refused")
        .to_string();
    assert!(wrong_hash.contains("wrong hash"), "{wrong_hash}");
    reasons.push(wrong_hash);
    assert_eq!(reasons.len(), 10);
    reasons.sort();
    reasons.dedup();
    assert_eq!(reasons.len(), 10, "{reasons:?}");
    assert_eq!(check_hash(&good, &sha256(&good)), Ok(()));
}

#[test]
fn a_single_flipped_bit_of_the_weights_is_seen() {
    let mut bytes = good(32, 7);
    let net = net(32, 7);
    let first: Vec<u8> = net.layers()[0].weights[..4]
        .iter()
        .flat_map(|weight| weight.to_le_bytes())
        .collect();
    let at = bytes
        .windows(first.len())
        .position(|window| window == first)
        .expect("the weights are in the file");
    // The lowest bit of a mantissa: no probe can tell.
    bytes[at] ^= 1;
    let reason = reason(&bytes);
    assert!(reason.contains("changed since it was written"), "{reason}");
}

#[test]
fn a_file_cut_anywhere_is_refused_and_never_taken_for_a_plain_one() {
    let good = good(8, 1);
    for length in 0..good.len() {
        assert!(decode(&good[..length]).is_err(), "cut to {length} bytes");
    }
}

#[test]
fn metadata_is_whole_or_absent() {
    let good = good(8, 1);
    for (key, other) in [
        ("vlaps.format", "vlaps.farmat"),
        ("vlaps.commit", "vlaps.commot"),
        ("vlaps.probe_inputs", "vlaps.probe_unputs"),
    ] {
        let reason = reason(&patched(&good, key.as_bytes(), other.as_bytes()));
        assert!(
            reason.contains(key) && reason.contains("missing"),
            "{reason}"
        );
    }
    let plain = patched(&good, b"vlaps.", b"other.");
    let file = decode(&plain).expect("a plain file");
    assert_eq!((file.provenance, file.probes.len()), (None, 0));
}

#[test]
fn layers_must_fit_each_other() {
    let layer = |inputs, outputs| Layer {
        weights: vec![0.1; inputs * outputs],
        bias: vec![0.0; outputs],
        inputs,
        outputs,
        activation: Activation::None,
    };
    for layers in [
        vec![],
        vec![layer(258, 2)],
        vec![layer(259, 3)],
        vec![layer(259, 4), layer(5, 2)],
    ] {
        let refusal = Mlp::new(layers).expect_err("refused");
        assert!(matches!(refusal, Refusal::WrongShape { .. }), "{refusal}");
    }
    let mut bad = layer(259, 2);
    bad.bias[1] = f32::INFINITY;
    let refusal = Mlp::new(vec![bad]).expect_err("refused");
    assert_eq!(refusal.to_string(), "a bias of layer 0 is not finite");
}

#[test]
fn a_net_that_overflows_is_refused() {
    let layer = |inputs, outputs| Layer {
        weights: vec![1e38; inputs * outputs],
        bias: vec![0.0; outputs],
        inputs,
        outputs,
        activation: Activation::None,
    };
    let mlp = Mlp::new(vec![layer(259, 4), layer(4, 2)]).expect("finite weights");
    let reason = reason(&policy::encode(&mlp, &policy::Provenance::default(), &[]));
    assert!(
        reason.contains("answer") && reason.contains("not finite"),
        "{reason}"
    );
}

/// The definition, output by output, in double precision.
fn by_definition(mlp: &Mlp, features: &[f32]) -> Vec<f64> {
    let Compression { from, to, slope } = mlp.compression();
    let compressed = |(k, &x): (usize, &f32)| {
        let slope = match (from..to).contains(&k) {
            true => f64::from(slope),
            false => 0.0,
        };
        f64::from(x) / (1.0 + slope * f64::from(x))
    };
    let mut x: Vec<f64> = features.iter().enumerate().map(compressed).collect();
    for layer in mlp.layers() {
        let rows = layer.weights.chunks_exact(layer.inputs);
        let sums = rows.zip(&layer.bias).map(|(row, &bias)| {
            let products = row.iter().zip(&x).map(|(&w, x)| f64::from(w) * x);
            f64::from(bias) + products.sum::<f64>()
        });
        x = sums
            .map(|sum| match layer.activation {
                Activation::None => sum,
                Activation::Relu => sum.max(0.0),
                Activation::Tanh => sum.tanh(),
            })
            .collect();
    }
    x
}

#[test]
fn files_made_by_pytorch_are_taken() {
    for (name, bytes) in [
        ("dynamo", &include_bytes!("data/torch_dynamo.onnx")[..]),
        ("torchscript", &include_bytes!("data/torch_script.onnx")[..]),
    ] {
        let file = decode(bytes).unwrap_or_else(|refusal| panic!("{name}: {refusal}"));
        assert_eq!(file.provenance, None, "{name}: a plain file");
        let Net::Mlp { mut mlp, .. } = file.net else {
            panic!("{name}: the native runtime takes it");
        };
        for case in torch::cases(include_str!("data/expected.txt")) {
            let answer = mlp.infer(&case.features);
            for k in 0..2 {
                let off = (answer[k] - case.answer[k]).abs();
                assert!(off < 1e-5, "{name}: {answer:?}, PyTorch {:?}", case.answer);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn the_runtime_answers_as_defined(
        hidden in 1_usize..150, seed in any::<u64>(), from in 0_usize..300, slope in 0.0_f32..50.0,
        features in prop::collection::vec(0.0_f32..=1.0, 259),
    ) {
        let layers = net(hidden, seed).layers().to_vec();
        let mut mlp = Mlp::compressed(Compression { from, to: 259, slope }, layers).expect("a net");
        let expected = by_definition(&mlp, &features);
        let answer = mlp.infer(&features);
        for k in 0..2 {
            prop_assert!((f64::from(answer[k]) - expected[k]).abs() < 1e-4, "{answer:?} {expected:?}");
        }
    }

    #[test]
    fn random_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..4096)) {
        prop_assert!(decode(&bytes).is_err());
    }

    #[test]
    fn spoilt_files_never_panic(
        seed in 0_u64..4,
        spoils in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20),
        length in any::<prop::sample::Index>(),
        cut in any::<bool>(),
    ) {
        let mut bytes = good(4, seed);
        for (at, byte) in spoils {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if cut {
            bytes.truncate(length.index(bytes.len()));
        }
        if let Ok(PolicyAnswer(answer)) = answer(&bytes) {
            prop_assert!(answer.iter().all(|value| value.is_finite()));
        }
    }
}

struct PolicyAnswer([f32; 2]);

/// What lets itself be read must let itself be run.
fn answer(bytes: &[u8]) -> Result<PolicyAnswer, Refusal> {
    match decode(bytes)?.net {
        Net::Mlp { mut mlp, .. } => Ok(PolicyAnswer(mlp.infer(&[0.5; 259]))),
        Net::Graph(_) => Ok(PolicyAnswer([0.0; 2])),
    }
}

/// A sum in the order of the inputs, one product and one addition at a time.
fn sum(bias: f32, terms: impl Iterator<Item = (f32, f32)>) -> f32 {
    terms.fold(bias, |sum, (weight, x)| sum + weight * x)
}

/// The answers of one convolution, by the definition.
fn answers(layer: &Windows, x: &[f32]) -> Vec<f32> {
    let mut y = x[..layer.kept].to_vec();
    for window in layer.indices.chunks(layer.window) {
        for (weights, bias) in layer.weights.chunks(layer.window).zip(&layer.bias) {
            let seen = window.iter().map(|k| x[*k as usize]);
            y.push(sum(*bias, weights.iter().copied().zip(seen)).max(0.0));
        }
    }
    y
}

#[test]
fn a_policy_may_have_convolutions_over_the_scan() {
    let mut mlp = convolved();
    let bytes = policy::encode(&mlp, &policy::Provenance::default(), &bad::probes());
    let Net::Mlp { mlp: read, .. } = decode(&bytes).expect("a good file").net else {
        panic!("a chain of layers");
    };
    assert_eq!(*read, mlp);
    for features in bad::probes() {
        let mut x = features.clone();
        mlp.compression().apply(&mut x);
        for layer in mlp.convolutions() {
            x = answers(layer, &x);
        }
        let layer = mlp.layers()[0].clone();
        let rows = layer.weights.chunks(layer.inputs).zip(&layer.bias);
        let expected = rows.map(|(row, bias)| {
            let terms = row.iter().copied().zip(x.iter().copied());
            sum(*bias, terms).tanh()
        });
        let expected: Vec<f32> = expected.collect();
        assert_eq!(mlp.infer(&features)[..], expected, "to the last bit");
    }
}

#[test]
fn convolutions_that_do_not_fit_are_refused() {
    let good = over_beams(9, 3);
    let layer = |inputs: usize| Layer {
        weights: vec![0.1; 2 * inputs],
        bias: vec![0.0; 2],
        inputs,
        outputs: 2,
        activation: Activation::Tanh,
    };
    type Change = fn(&mut Windows);
    let changes: [(&str, Change); 6] = [
        ("the shape", |layer| layer.indices[7] = 259),
        ("the shape", |layer| layer.kept = 260),
        ("the shape", |layer| layer.window = 0),
        ("the shape", |layer| layer.weights.truncate(5)),
        ("the input", |layer| layer.inputs = 300),
        ("a weight", |layer| layer.weights[0] = f32::NAN),
    ];
    for (what, change) in changes {
        let mut bad = good.clone();
        change(&mut bad);
        let layers = vec![layer(good.outputs())];
        let refusal = Mlp::convolved(Compression::default(), vec![bad], layers);
        let told = refusal.expect_err("refused").to_string();
        assert!(told.contains(&format!("{what} of convolution 0")), "{told}");
    }
    let (by, layers) = (Compression::default(), vec![layer(259)]);
    let refusal = Mlp::convolved(by, vec![good], layers).expect_err("refused");
    assert!(refusal.to_string().contains("the input of layer 0"));
}
