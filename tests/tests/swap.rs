//! Weights are swapped while a real process set drives: whole and checked, or not at
//! all. They survive restarts of the controller and of the run.

#[path = "../../policy/tests/bad/mod.rs"]
mod bad;

use shm_config::Message;
use std::fs::{self, File};
use std::process::{Command, Output};

use rustix::process::Signal;
use vlaps_tests::{Set, programs, until};

fn supervisor(set: &Set, words: &[&str]) -> Output {
    Command::new(programs().join("vlaps-supervisor"))
        .args(words)
        .args(["--run", &set.name().to_string()])
        .current_dir(set.folder())
        .output()
        .expect("the supervisor starts")
}

fn text(output: &Output) -> String {
    let both = [&output.stdout[..], &output.stderr[..]].concat();
    String::from_utf8_lossy(&both).into_owned()
}

/// The version in use and its hash, as `status` shows them.
fn in_charge(set: &Set) -> (u64, String) {
    let output = supervisor(set, &["status", "--json", "status.json"]);
    assert!(output.status.success(), "{}", text(&output));
    let json = fs::read_to_string(set.folder().join("status.json")).expect("a status");
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let policy = &json["runs"][0]["policy"];
    let hash = policy["hash"].as_str().unwrap_or_default();
    (policy["version"].as_u64().unwrap_or(0), hash.into())
}

/// Any net passes this canary period, because the test does not depend on how it
/// drives.
const LENIENT: [&str; 4] = [
    "--set",
    "policy.veto_rate_max=1.0",
    "--set",
    "policy.shadow_ticks=3",
];

fn start(set: &mut Set, more: &[&str]) {
    set.start(&[&["--seed", "3", "--no-realtime"], &LENIENT[..], more].concat());
    until("the set drives", || {
        let output = supervisor(set, &["status", "--json", "status.json"]);
        output.status.success() && text(&output).contains(" drives (")
    });
}

#[test]
fn weights_are_adopted_or_refused_while_the_set_drives() {
    let mut set = Set::new("swap");
    let first = bad::good(32, 1);
    fs::write(set.folder().join("first.onnx"), &first).expect("a file");
    start(&mut set, &["--policy", "first.onnx"]);
    until("the first weights may drive", || in_charge(&set).0 == 1);
    let (_, hash) = in_charge(&set);

    let mut reasons = Vec::new();
    for (kind, bytes, word) in bad::bad(&first) {
        let file = format!("{kind}.onnx");
        fs::write(set.folder().join(&file), bytes).expect("a file");
        let output = supervisor(&set, &["swap", &file]);
        let said = text(&output);
        assert_eq!(output.status.code(), Some(1), "{kind}: {said}");
        assert!(
            said.contains("refused") && said.contains(word),
            "{kind}: {said}"
        );
        assert_eq!(in_charge(&set), (1, hash.clone()), "{kind} changed nothing");
        reasons.push(said);
    }
    // A sparse file: no gigabyte needs to be written.
    let large = File::create(set.folder().join("large.onnx")).expect("a file");
    large.set_len(1 << 30).expect("a gigabyte");
    let output = supervisor(&set, &["swap", "large.onnx"]);
    let said = text(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("over the limit"), "{said}");
    reasons.push(said);
    reasons.push(wrong_hash(&set, &first));
    assert_eq!(in_charge(&set), (1, hash.clone()));
    assert_eq!(reasons.len(), 10);

    fs::write(set.folder().join("second.onnx"), bad::good(32, 2)).expect("a file");
    let output = supervisor(&set, &["swap", "second.onnx", "--wait-ready"]);
    let said = text(&output);
    assert!(output.status.success(), "{said}\n{}", set.logs());
    assert!(said.contains("adopted at tick"), "{said}");
    let (version, second) = in_charge(&set);
    assert!(version > 1 && second != hash, "{version} {second}");

    // The controller dies and returns with the weights it had.
    set.signal_program("vlaps-controller", Signal::KILL);
    until("the weights are back", || {
        in_charge(&set) == (version, second.clone())
    });
    set.signal(Signal::INT);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    let json = set.json();
    assert_eq!(json["policy"]["version"].as_u64(), Some(version), "{json}");

    // A new run of the same name has them too.
    start(&mut set, &[]);
    until("the weights are back", || {
        in_charge(&set) == (version, second.clone())
    });
}

/// Makes an offer whose hash belongs to other bytes; returns the reason of the refusal.
fn wrong_hash(set: &Set, bytes: &[u8]) -> String {
    use shm_config::services::{POLICY_STATUS, Process, WEIGHTS};
    let wire = shm_config::wire::Wire::join(set.name(), Process::Learner).expect("the run");
    let mut offers = wire.publisher(WEIGHTS).expect("a port");
    let mut statuses = wire.subscriber(POLICY_STATUS).expect("a port");
    let mut newest = None;
    until("the controller has said what it has", || {
        statuses.update_connections();
        newest = statuses.newest(Message::check).or(newest);
        newest.is_some()
    });
    let version = newest.map_or(0, |status| status.offered_version) + 1;
    offers.update_connections();
    assert!(offers.offer(version, [7; 32], bytes));
    let mut reason = String::new();
    until("the offer is refused", || {
        offers.update_connections();
        statuses.update_connections();
        if let Some(status) = statuses.newest(Message::check)
            && status.offered_version == version
        {
            reason = status.refusal().into_owned();
        }
        !reason.is_empty()
    });
    assert!(reason.contains("wrong hash"), "{reason}");
    reason
}

#[test]
fn a_bad_policy_at_the_start_ends_the_run_with_its_reason() {
    let set = Set::new("badstart");
    fs::write(set.folder().join("bad.onnx"), b"\x08\x08cut").expect("a file");
    let output = set.run(&["--lockstep", "--duration", "5", "--policy", "bad.onnx"]);
    let said = text(&output);
    assert!(!output.status.success(), "{said}");
    assert!(
        said.contains("bad.onnx") && !said.contains("panicked"),
        "{said}"
    );
}

#[test]
fn a_policy_drives_in_lockstep_the_same_each_time() {
    let drive = |label: &str| {
        let set = Set::new(label);
        fs::write(set.folder().join("policy.onnx"), bad::good(32, 1)).expect("a file");
        let words = [
            "--lockstep",
            "--seed",
            "3",
            "--duration",
            "20",
            "--gate",
            "policy",
        ];
        let output = set.run(&[&words[..], &LENIENT[..], &["--policy", "policy.onnx"]].concat());
        assert!(output.status.success(), "{}\n{}", text(&output), set.logs());
        set.json()
    };
    let (a, b) = (drive("policya"), drive("policyb"));
    assert_eq!(a["command_digest"], b["command_digest"]);
    assert_eq!(a["reasons"], b["reasons"]);
    assert_eq!(
        a["reasons"]["expert"]["shadow"], 3,
        "its canary period: {a}"
    );
    assert!(a["share"]["policy"].as_f64() > Some(0.01), "{a}");
    assert_eq!(a["policy"]["version"], 1, "{a}");
}

#[test]
fn without_a_run_nothing_is_swapped() {
    let set = Set::new("noswap");
    fs::write(set.folder().join("good.onnx"), bad::good(8, 1)).expect("a file");
    let output = supervisor(&set, &["swap", "good.onnx"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output).contains("not running"), "{}", text(&output));
    let output = supervisor(&set, &["swap", "nowhere.onnx"]);
    assert_eq!(output.status.code(), Some(2));
}
