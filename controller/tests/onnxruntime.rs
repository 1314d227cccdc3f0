//! Policies that are no chain of layers run in ONNX Runtime, where it is.

use controller::{Policy, Terms, build, library};
use shm_config::config::{Backend, Config};
use shm_config::message::FEATURES;
use shm_config::time::monotonic;
use vehicle::Action;

use crate::convolved;
use crate::torch;

const GATED: &[u8] = include_bytes!("../../policy/tests/data/torch_gated.onnx");

fn config() -> Config {
    let mut config = Config::default();
    // A test asserts no maximum run time.
    config.policy.inference_max_us = 1e6;
    config.policy.ort_wait_us = 1e5;
    config
}

fn built(config: &Config) -> Result<Box<dyn Policy>, policy::Refusal> {
    built_of(GATED, config)
}

#[allow(clippy::disallowed_methods)] // a test is an entry point
fn built_of(bytes: &[u8], config: &Config) -> Result<Box<dyn Policy>, policy::Refusal> {
    let terms = Terms {
        config,
        version: 3,
        clock: monotonic,
    };
    build(bytes, &terms)
}

#[test]
fn without_the_library_it_is_refused_and_told_what_to_do() {
    let mut config = config();
    config.policy.onnxruntime = "/nowhere".into();
    let refusal = built(&config).err().expect("refused").to_string();
    assert!(refusal.contains("./vlaps setup onnxruntime"), "{refusal}");
    config.policy.backend = Backend::Native;
    let refusal = built(&config).err().expect("refused").to_string();
    assert!(refusal.contains("policy.backend is native"), "{refusal}");
}

/// Whether the library is there; says so if it is not.
fn has_library() -> bool {
    use std::io::Write;
    let Err(refusal) = library("") else {
        return true;
    };
    // Past the capture of test output: a skipped test must not look passed.
    let _ = writeln!(std::io::stderr(), "skipped: {refusal}");
    false
}

#[test]
fn convolutions_have_the_same_answers_as_in_the_native_runtime() {
    if !has_library() {
        return;
    }
    let probes: Vec<Vec<f32>> = (0..20)
        .map(|row| {
            let feature = |k| ((k * (row + 3)) as f32 * 0.37).sin().abs();
            (0..FEATURES).map(feature).collect()
        })
        .collect();
    let mut native = convolved::convolved();
    let bytes = policy::encode(&native, &policy::Provenance::default(), &probes[..2]);
    let mut config = config();
    config.policy.backend = Backend::Ort;
    let mut policy = built_of(&bytes, &config).expect("a graph of allowed operators");
    for features in &probes {
        let Action { steer, pedal } = policy.infer(features).expect("an answer in time");
        let [own_steer, own_pedal] = native.infer(features).map(f64::from);
        let off = (steer - own_steer).abs() + (pedal - own_pedal).abs();
        assert!(off < 1e-5, "{steer} {pedal}, and {own_steer} {own_pedal}");
    }
}

#[test]
fn it_answers_as_pytorch_does() {
    if !has_library() {
        return;
    }
    let mut policy = built(&config()).expect("a graph of allowed operators");
    assert_eq!(policy.version(), 3);
    for case in torch::cases(include_str!("../../policy/tests/data/expected_gated.txt")) {
        let Action { steer, pedal } = policy.infer(&case.features).expect("an answer in time");
        let [expected_steer, expected_pedal] = case.answer.map(f64::from);
        let off = (steer - expected_steer).abs() + (pedal - expected_pedal).abs();
        assert!(off < 1e-5, "{steer} {pedal}, PyTorch {:?}", case.answer);
    }
}
