//! The program as users call it.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn bench(words: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vlaps-bench"))
        .args(words)
        .output()
        .expect("the program starts")
}

fn scratch(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join(name)
}

#[test]
fn mistakes_are_named_with_exit_code_2() {
    for (words, hint) in [
        (&["bench", "sim", "--json", "."][..], "--json ."),
        (
            &["bench", "swap", "--seconds", "4", "--rate", "10"],
            "--seconds 4: too short for a swap; at least 5",
        ),
        (
            &["bench", "latency", "--rate", "10,2000"],
            "2000 Hz, none, real-time: run.rate_hz = 2000: must be",
        ),
        (&["bench", "latency", "--rate", "10,nan"], "run.rate_hz"),
        (&["bench", "latency", "--rate", "-5"], "run.rate_hz = -5"),
        (
            &["bench", "latency", "--set", "planner.rate_hz=7"],
            "planner.rate_hz = 7",
        ),
        (
            &["bench", "latency", "--set", "planner.rat=7"],
            "planner.rate_hz",
        ),
        (
            &["bench", "latency", "--set", "run.rate_hz=50"],
            "use --rate",
        ),
        (&["bench", "latency", "--set", "run.name=x"], "leave it out"),
        (&["bench", "faults", "--kinds", "clock"], "--step-clock"),
        (
            &["bench", "faults", "--set", "run.faults=false"],
            "run.faults is set by",
        ),
        (&["bench", "faults", "--rate", "15"], "run.rate_hz = 15"),
    ] {
        let output = bench(words);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {text}");
        assert!(text.contains(hint), "{words:?}: {text}");
    }
}

#[test]
fn a_judge_that_answers_nothing_is_an_error_that_says_why() {
    // Port 9 is discard: no server listens there.
    let words = "bench judge --scenes 2 --view top_down --server http://127.0.0.1:9/v1 \
                 --set vlm.attempts_max=1";
    let output = bench(&words.split_whitespace().collect::<Vec<_>>());
    let [text, error] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    assert_eq!(output.status.code(), Some(1), "{text} {error}");
    let why = "no answer to any of 2 scenes; top_down: 2 connection_refused";
    assert!(error.contains(why), "{error}");
    assert!(
        !text.contains("NaN") && !text.contains("stand-in"),
        "{text}"
    );
}

#[test]
fn an_address_with_a_key_is_not_printed() {
    let words = [
        "bench",
        "judge",
        "--server",
        "http://127.0.0.1:9/v1?key=sk-secret",
    ];
    let output = bench(&words);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(
        text.contains("vlm.server") && !text.contains("sk-secret"),
        "{text}"
    );
}

#[test]
fn parity_without_recordings_says_what_is_missing() {
    let empty = scratch("no-recordings");
    std::fs::create_dir_all(&empty).expect("a folder");
    let output = bench(&["bench", "parity", "--data", &empty.display().to_string()]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("golden_"), "{text}");
}
