//! Text of a server, a path or a file is shown in terminals, logs and pages without
//! effect.

mod server;

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};

use serde_json::json;
use server::{Answer, HOSTILE, KEY, Server, files_below, is_raw, policy, refuses, said};
use vlaps_tests::{Set, programs};

/// An answer whose text is invalid, from a model with a hostile name.
fn babbles(_: &str) -> (&'static str, String) {
    let body = json!({
        "model": HOSTILE,
        "choices": [{"message": {"content": HOSTILE}, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": 10, "completion_tokens": 10},
    });
    ("200 OK", body.to_string())
}

/// Drives a set whose judge is a server with hostile text; returns all texts that a
/// user may read afterwards, by name.
fn readings(label: &str, answer: Answer) -> Vec<(String, String)> {
    let server = Server::start(answer);
    let set = Set::new(label);
    let (address, policy) = (format!("vlm.server={}", server.url), policy());
    let model = format!("vlm.model={HOSTILE}");
    let output = set
        .up_command(
            &[],
            &[
                "--lockstep",
                "--seed",
                "1003",
                "--duration",
                "12",
                "--policy",
                &policy,
                "--gate",
                "vlm",
                "--set",
                &address,
                "--set",
                "vlm.attempts_max=1",
                "--set",
                &model,
            ],
        )
        .env("VLAPS_VLM_KEY", KEY)
        .output()
        .expect("the supervisor starts");
    assert!(output.status.success(), "{}", said(&output));
    assert!(server.was_sent(KEY) > 0, "it was asked");
    let run = set.folder().join("runs").join(set.name().to_string());
    let audit = Command::new(programs().join("vlaps-judge"))
        .arg("audit")
        .arg(&run)
        .output()
        .expect("the audit starts");
    assert!(audit.status.success(), "{}", said(&audit));
    let is_text = |file: &PathBuf| {
        let end = file.extension().unwrap_or_default().to_string_lossy();
        ["log", "html", "json", "jsonl", "csv"].contains(&&*end)
    };
    let files = files_below(set.folder()).into_iter().filter(is_text);
    let mut readings: Vec<_> = files
        .map(|file| {
            let bytes = fs::read(&file).unwrap_or_default();
            let name = file.file_name().unwrap_or_default().display().to_string();
            (name, String::from_utf8_lossy(&bytes).into_owned())
        })
        .collect();
    readings.push(("output".into(), said(&output)));
    readings.push(("output of the audit".into(), said(&audit)));
    readings
}

#[test]
fn text_of_a_server_is_shown_without_effect() {
    for (label, answer, shown_in) in [
        (
            "refuses",
            refuses as Answer,
            &["output", "gate.log", "audit.html"][..],
        ),
        ("babbles", babbles, &["audit.html"]),
    ] {
        let readings = readings(label, answer);
        for (name, text) in &readings {
            assert!(!is_raw(text), "{label}, {name}: {}", text.escape_debug());
            assert!(!text.contains(KEY), "{label}, {name}");
        }
        for expected in shown_in {
            let found = readings.iter().find(|(name, _)| name == expected);
            let (_, text) = found.unwrap_or_else(|| panic!("{label}: no {expected}"));
            // The logging library writes escape sequences in another form.
            let shown = "rlo\\u{202e} lri\\u{2066} zero\\u{200b}\\u{feff}";
            assert!(text.contains(shown), "{label}, {expected}: {text}");
        }
        let records = readings.iter().find(|(name, _)| name == "questions.jsonl");
        let (_, records) = records.expect("records");
        let record = records.lines().next().expect("a record");
        let record: serde_json::Value = serde_json::from_str(record).expect("JSON");
        let kept = record["askings"][0]["said"]
            .as_str()
            .expect("what was said");
        assert!(
            kept.contains(HOSTILE),
            "a record keeps what was said: {kept}"
        );
    }
}

#[test]
fn text_of_a_path_or_a_key_is_shown_without_effect() {
    let folder = tempfile::tempdir().expect("a folder");
    let unknown = format!("[vlm]\n{} = 1\n", json!(HOSTILE));
    fs::write(folder.path().join("unknown.toml"), unknown).expect("written");
    let value = format!("[vlm]\nprompt = {}\n", json!(HOSTILE));
    fs::write(folder.path().join("value.toml"), value).expect("written");
    let missing = format!("{HOSTILE}.toml");
    let setting = format!("vlm.{HOSTILE}=1");
    let option = format!("--{HOSTILE}");
    let nowhere = format!("{HOSTILE}/x.json");
    let cases: [(&str, Vec<&str>); 12] = [
        ("vlaps-supervisor", vec!["up", "--policy", &missing]),
        ("vlaps-lab", vec!["eval", "--json", &nowhere]),
        ("vlaps-supervisor", vec!["up", "--config", &missing]),
        ("vlaps-supervisor", vec!["up", "--config", "unknown.toml"]),
        ("vlaps-supervisor", vec!["up", "--config", "value.toml"]),
        ("vlaps-supervisor", vec!["up", "--set", &setting]),
        ("vlaps-supervisor", vec!["up", &option]),
        ("vlaps-supervisor", vec!["status", "--run", HOSTILE]),
        ("vlaps-supervisor", vec!["eval", "--config", &missing]),
        ("vlaps-lab", vec!["eval", &option]),
        ("vlaps-judge", vec!["audit", HOSTILE]),
        ("vlaps-planner", vec!["--config", "unknown.toml"]),
    ];
    for (program, words) in cases {
        let output = Command::new(programs().join(program))
            .args(&words)
            .current_dir(folder.path())
            .stdin(Stdio::null())
            .output()
            .expect("it starts");
        let said = said(&output);
        assert!(!output.status.success(), "{program} {words:?}: {said}");
        assert!(
            !is_raw(&said),
            "{program} {words:?}: {}",
            said.escape_debug()
        );
        let is_shown = said.contains("red\\u{1b}[31m c1\\u{9b}2J rlo\\u{202e}");
        assert!(is_shown, "{program} {words:?}: {said}");
    }
}

#[test]
fn an_unknown_key_as_long_as_a_file_is_refused_in_a_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("long.toml");
    fs::write(&path, format!("{} = 1\n", "k".repeat(900_000))).expect("written");
    let output = Command::new(programs().join("vlaps-supervisor"))
        .args(["up", "--config"])
        .arg(&path)
        .output()
        .expect("it starts");
    let said = said(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("unknown key 'kkk") && said.len() < 4096,
        "{}",
        said.len()
    );
}
