//! A distilled judge in real process sets: it answers first, passes on what it does not
//! know, and its file is checked before anything drives.

use std::fs;
use std::path::PathBuf;

use gate::distilled::{About, INPUTS, OUTPUTS, Range, assemble, encode};
use gate::record::store;
use policy::{Activation, Layer};
use serde_json::Value;
use vlaps_tests::Set;

/// Place of the progress among the features: behind scene, sectors, action, the windows
/// of the rollout and five numbers of what it comes near to.
const PROGRESS: usize = 16 + 48 + 2 + 20 + 5;

/// A threshold that no confidence reaches.
const UNSURE: f64 = 1.5;

/// A net that finds the proposal with more progress safer, and is sure where one gets
/// much farther.
fn file(threshold: f64) -> Vec<u8> {
    let mut weights = vec![0.0; OUTPUTS * INPUTS];
    weights[PROGRESS] = 200.0;
    let layer = Layer {
        weights,
        bias: vec![0.0; OUTPUTS],
        inputs: INPUTS,
        outputs: OUTPUTS,
        activation: Activation::None,
    };
    let about = About {
        members: 1,
        temperature: 1.0,
        threshold,
        range: Range {
            low: vec![-2.0; INPUTS],
            high: vec![2.0; INPUTS],
        },
        teacher: "rules".into(),
        preset: String::new(),
        model: String::new(),
        learned: "answers".into(),
        questions: 1,
        seed: 0,
        commit: String::new(),
    };
    encode(&assemble(vec![layer], about).expect("a net"))
}

fn drive(set: &Set, net: &[u8], more: &[&str]) -> (i32, Value) {
    let policy =
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../results/learning/ppl-10000.onnx");
    let policy = policy.display().to_string();
    let path = set.folder().join("judge.onnx");
    fs::write(&path, net).expect("written");
    let file = format!("gate.distilled={}", path.display());
    let mut arguments = vec!["--lockstep", "--seed", "1003", "--duration", "40"];
    arguments.extend(["--gate", "distilled", "--set", &file, "--policy", &policy]);
    arguments.extend(["--set", "gate.pass_to=rules", "--set", "gate.audit=0.5"]);
    arguments.extend(more);
    let output = set.run(&arguments);
    let code = output.status.code().unwrap_or(-1);
    let json = match code {
        0 => set.json(),
        _ => Value::String(format!(
            "{}{}",
            String::from_utf8_lossy(&output.stderr),
            set.logs()
        )),
    };
    (code, json)
}

#[test]
fn a_net_answers_first_and_passes_on_and_runs_repeat() {
    let [one, other] = ["one", "other"].map(Set::new);
    let (code, json) = drive(&one, &file(0.8), &["--set", "gate.foresight=true"]);
    assert_eq!(code, 0, "{json}");
    let net = &json["judge"]["net"];
    let count = |key: &str| net[key].as_u64().expect(key);
    assert!(count("answered") > 0, "{net}");
    assert!(
        count("audited") > 0 && count("agreed") <= count("audited"),
        "{net}"
    );
    assert_eq!(json["judge"]["failed"], 0, "{json}");
    assert!(json["share"]["policy"].as_f64().expect("a share") > 0.0);
    let folder = one.folder().join("runs").join(one.name().to_string());
    let records = store::read(&folder).expect("records").questions;
    assert_eq!(records.len() as u64, count("answered") + count("passed_on"));
    for record in &records {
        assert_eq!(record.heard_tick, record.tick, "answered at once");
        assert!(record.foresight.is_some() && record.observation.is_some());
        assert!(record.net.is_some());
    }
    // A net that is never sure passes every question on.
    let (code, unsure) = drive(&Set::new("unsure"), &file(UNSURE), &[]);
    assert_eq!(code, 0, "{unsure}");
    let net = &unsure["judge"]["net"];
    assert_eq!(net["answered"], 0, "{net}");
    assert!(net["passed_on"].as_u64().expect("a count") > 0, "{net}");
    let (code, again) = drive(&other, &file(0.8), &["--set", "gate.foresight=true"]);
    assert_eq!(code, 0, "{again}");
    assert_eq!(json["command_digest"], again["command_digest"]);
    assert_eq!(json["judge"]["net"], again["judge"]["net"]);
}

#[test]
fn a_slow_judge_that_fails_lets_the_expert_drive() {
    let set = Set::new("failing");
    // Nothing listens there.
    let unreachable = [
        "--set",
        "gate.pass_to=vlm",
        "--set",
        "vlm.server=http://127.0.0.1:9/v1",
    ];
    // From above 1 on it never answers.
    let (code, json) = drive(&set, &file(UNSURE), &unreachable);
    assert_eq!(code, 0, "{json}");
    assert_eq!(json["judge"]["net"]["answered"], 0, "{json}");
    assert_eq!(json["share"]["policy"], 0.0, "{json}");
    assert!(json["judge"]["failed"].as_u64().expect("a count") > 0);
}

#[test]
fn a_file_that_is_no_distilled_judge_ends_the_run_with_the_reason() {
    let good = file(0.8);
    let policy =
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../results/learning/ppl-10000.onnx");
    let policy = fs::read(policy).expect("a policy");
    for (label, bytes, word) in [
        ("truncated", &good[..good.len() - 40], "truncated"),
        ("policy", &policy, "kind"),
        ("text", b"not a net", "not an ONNX file"),
    ] {
        let set = Set::new(label);
        let (code, text) = drive(&set, bytes, &[]);
        let text = text.to_string();
        assert_ne!(code, 0, "{label}");
        assert!(
            text.contains("judge.onnx") && text.contains(word),
            "{label}: {text}"
        );
    }
}
