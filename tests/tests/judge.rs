//! A vision-language model as judge of real process sets. The model is the stand-in: it
//! speaks the same protocol over HTTP, and decides by pixels alone.

use shm_config::message::Preference;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use gate::record::Record;
use gate::record::store;
use judge::pixels::PixelRules;
use judge::standin::{Options, Server, ServerFault};
use serde_json::Value;
use shm_config::config::{GateMode, When, load};
use vlaps_tests::{Set, until};

/// A policy trained for 9,800 steps, whose proposals the judge compares.
fn policy() -> String {
    let file = "../results/learning/ppl-10000.onnx";
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(file);
    path.display().to_string()
}

fn stand_in() -> Server {
    let options = Options {
        rater: Arc::new(PixelRules),
        ..Options::default()
    };
    Server::start(options).expect("a stand-in")
}

/// Drives in lockstep with this server as judge.
fn drive(set: &Set, server: &str, more: &[&str]) -> Value {
    let policy = policy();
    let server = format!("vlm.server={server}");
    let mut arguments = vec![
        "--lockstep",
        "--seed",
        "1003",
        "--policy",
        &policy,
        "--set",
        &server,
        // In lockstep half a minute passes in about a second.
        "--set",
        "vlm.per_minute_max=10000",
    ];
    arguments.extend(more);
    if !more.contains(&"--duration") {
        arguments.extend(["--duration", "30"]);
    }
    let output = set.run(&arguments);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    set.json()
}

fn folder_of(set: &Set) -> PathBuf {
    set.folder().join("runs").join(set.name().to_string())
}

fn records(set: &Set) -> Vec<Record> {
    let read = store::read(&folder_of(set).join("judge"));
    read.expect("records of questions").questions
}

#[test]
fn a_model_is_asked_and_its_recorded_answers_replay_to_the_same_commands() {
    let server = stand_in();
    let asked = Set::new("asked");
    let json = drive(&asked, &server.url(), &["--gate", "vlm"]);
    let records = records(&asked);
    assert!(records.len() >= 3, "{} questions in 30 s", records.len());
    for record in &records {
        assert_ne!(record.preference, None, "{}", record.fault);
        assert_eq!(record.askings.len(), 2, "asked twice");
        let [first, second] = [&record.askings[0], &record.askings[1]];
        assert_eq!(second.showing, first.showing.swapped());
        assert!(!first.picture.is_empty());
        assert!(record.foresight.is_some(), "the simulator knows");
        for word in ["expert", "policy", "novice", "learned"] {
            assert!(!first.user.to_lowercase().contains(word), "{word}");
        }
    }
    let answered = |preference| {
        records
            .iter()
            .filter(|r| r.preference == preference)
            .count()
    };
    let drove = json["share"]["policy"].as_f64().expect("a share") > 0.0;
    assert_eq!(drove, answered(Some(Preference::Policy)) > 0, "{json}");

    let recording = format!(
        "gate.recording={}",
        folder_of(&asked).join("judge").display()
    );
    drop(server);
    let replayed = Set::new("replayed");
    let again = drive(
        &replayed,
        "http://127.0.0.1:9/v1",
        &["--gate", "replay", "--set", &recording],
    );
    for key in ["questions", "expert", "policy", "abstained", "failed"] {
        assert_eq!(json["judge"][key], again["judge"][key], "{key}");
    }
    assert!(!folder_of(&replayed).join("judge").exists(), "kept once");
    assert_eq!(json["command_digest"], again["command_digest"]);
    assert_eq!(json["reasons"], again["reasons"]);
}

#[test]
fn a_judge_that_breaks_lets_the_expert_drive_and_leaves_no_label() {
    let broken = |injected| Options {
        injected: Some(injected),
        ..Options::default()
    };
    for injected in [
        ServerFault::Two,
        ServerFault::Unauthorized,
        ServerFault::HugeLength,
    ] {
        let server = Server::start(broken(injected)).expect("a stand-in");
        let set = Set::new("broken");
        let quick = [
            "--gate",
            "vlm",
            "--duration",
            "12",
            "--set",
            "vlm.attempts_max=1",
        ];
        let json = drive(&set, &server.url(), &quick);
        assert_eq!(json["share"]["policy"], 0.0, "{}", injected.word());
        let trouble = json["judge"]["trouble"].as_str().expect("a text");
        let is_told = trouble.contains("http_401") && trouble.contains("vlm.key_env");
        assert_eq!(is_told, injected == ServerFault::Unauthorized, "{trouble}");
        assert_eq!(json["skipped"], 0);
        let records = records(&set);
        assert!(!records.is_empty());
        for record in records {
            assert_eq!(record.preference, None, "{}", injected.word());
            assert!(!record.fault.is_empty(), "one reason");
        }
    }
}

#[test]
fn in_real_time_a_judge_that_hangs_or_dies_costs_no_tick() {
    for injected in [Some(ServerFault::Hang), None] {
        let options = Options {
            injected,
            ..Options::default()
        };
        let mut server = Some(Server::start(options).expect("a stand-in"));
        let url = server.as_ref().map(Server::url).unwrap_or_default();
        let mut set = Set::new("real-time");
        let (policy, url) = (policy(), format!("vlm.server={url}"));
        set.start(&[
            "--seed",
            "1003",
            "--duration",
            "6",
            "--policy",
            &policy,
            "--gate",
            "vlm",
            "--set",
            &url,
        ]);
        let asked = |server: &Option<Server>| server.as_ref().is_some_and(|s| s.requests() > 0);
        until("the judge is asked", || asked(&server));
        if injected.is_none() {
            server = None;
        }
        assert_eq!(set.wait(), Some(0), "{}", set.logs());
        let json = set.json();
        let number = |key: &str| json[key].as_f64().expect(key);
        let instants = (number("elapsed_s") / number("period_s")).round();
        assert_eq!(instants, number("ticks") + number("skipped"));
        drop(server);
    }
}

#[test]
fn the_papers_mode_pauses_the_world_and_names_both() {
    let server = stand_in();
    let set = Set::new("paper");
    let own_name = ["--gate", "paper", "--set", "vlm.model=vlaps-stand-in"];
    let json = drive(&set, &server.url(), &own_name);
    assert_eq!(json["judge"]["cost_usd"], 0.0, "{json}");
    let judge = json["judge"]["judge"].as_str().expect("a text");
    assert!(judge.starts_with("paper, vlaps-stand-in at "), "{judge}");
    let records = records(&set);
    let ticks: Vec<u64> = records.iter().map(|record| record.tick).collect();
    assert!(ticks.len() >= 3, "{ticks:?}");
    let mut gaps = ticks.windows(2).map(|pair| pair[1] - pair[0]);
    assert!(gaps.all(|gap| gap == 100), "every 10 s: {ticks:?}");
    for record in &records {
        assert_eq!(record.heard_tick, record.tick, "the world waited");
        assert_eq!(record.askings.len(), 1);
        assert!(record.askings[0].user.contains("expert"));
    }
    assert_eq!(json["skipped"], 0);
    let saved = load(&folder_of(&set).join("config.toml")).expect("the saved configuration");
    assert_eq!(saved.gate.mode, GateMode::Paper);
    assert_eq!((saved.gate.when, saved.gate.dwell_s), (When::Period, 0.0));
    assert_eq!((saved.vlm.ask_twice, saved.vlm.horizon_s), (false, 1.5));
    let text = std::fs::read_to_string(folder_of(&set).join("config.toml")).expect("a file");
    for line in [
        "ask_twice = false",
        "handover_steer_per_s = 0.0",
        "prompt = \"paper\"",
    ] {
        assert!(text.contains(line), "{line} drove, and is not in: {text}");
    }
}

#[test]
fn in_lockstep_a_model_may_think_for_longer_than_a_silent_process_lives() {
    let options = Options {
        latency: Duration::from_secs(4),
        ..Options::default()
    };
    let server = Server::start(options).expect("a stand-in");
    let set = Set::new("slow");
    let quick = ["--gate", "paper", "--duration", "5"];
    let json = drive(&set, &server.url(), &quick);
    assert_eq!(json["restarts"], 0, "{}", set.logs());
    assert_eq!(json["judge"]["failed"], 0, "{json}");
    assert!(json["judge"]["questions"].as_u64() > Some(0), "{json}");
}
