//! Situations of a new user: refusals that say what to do, output whose reader ends, a
//! small container, and figures that explain themselves.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use rustix::process::Signal;
use serde_json::Value;
use vlaps_tests::{Set, programs, skip_unless, until};

const NAMESPACES: &str = "this machine grants no user and mount namespaces (unshare -rm)";
/// Mounts a file system of a size in place of shared memory, then runs the rest.
const SMALL: [&str; 4] = ["unshare", "-rm", "sh", "-c"];

fn program(name: &str, folder: &Path, words: &[&str]) -> Output {
    let mut command = Command::new(programs().join(name));
    let command = command.args(words).current_dir(folder);
    command.stdin(Stdio::null()).output().expect("it runs")
}

fn vlaps(folder: &Path, words: &[&str]) -> Output {
    let name = match words[0] {
        "eval" | "draw" | "train" | "sweep" => "vlaps-lab",
        "bench" => "vlaps-bench",
        "server" => "vlaps-judge",
        _ => "vlaps-supervisor",
    };
    program(name, folder, words)
}

fn said(output: &Output) -> String {
    let text = |bytes| String::from_utf8_lossy(bytes).into_owned();
    text(&output.stdout) + &text(&output.stderr)
}

/// Asserts a refusal with exit code 2 and these words, before anything is created.
fn assert_refused(words: &[&str], parts: &[&str]) {
    let folder = tempfile::tempdir().expect("a folder");
    let output = vlaps(folder.path(), words);
    let text = said(&output);
    assert_eq!(output.status.code(), Some(2), "{words:?}: {text}");
    for part in parts {
        assert!(
            text.contains(part),
            "{words:?}: '{part}' is missing in: {text}"
        );
    }
    let made = fs::read_dir(folder.path()).expect("the folder").count();
    assert_eq!(made, 0, "{words:?} made something");
}

#[test]
fn an_impossible_car_is_refused_by_every_command() {
    let parts = ["vehicle.length_m = 120", "must be within 0.05 and 30"];
    let set = ["--set", "vehicle.length_m=120"];
    for command in [
        &["up", "--lockstep", "--episodes", "1"][..],
        &["draw", "map", "--seed", "3"],
        &["draw", "episode", "--seed", "3"],
        &["eval", "--episodes", "1"],
        &["train", "--steps", "200"],
    ] {
        assert_refused(&[command, &set].concat(), &parts);
    }
    let metadrive = [
        "up",
        "--world",
        "metadrive",
        "--set",
        "vehicle.max_speed_mps=2",
    ];
    assert_refused(
        &metadrive,
        &["vehicle.max_speed_mps = 2", "MetaDrive drives its own car"],
    );
}

#[test]
fn a_refusal_names_the_option_and_what_it_may_be() {
    let long = "a".repeat(300);
    assert_refused(
        &["up", "--set", "planner.iterations=-4"],
        &[
            "--set planner.iterations=-4",
            "a whole number from 1 to 4095",
        ],
    );
    assert_refused(&["up", "--rate", "0"], &["error: --rate: run.rate_hz = 0"]);
    assert_refused(
        &["up", "--duration", "1e300"],
        &["run.duration_s = 1e300: must be"],
    );
    assert_refused(
        &["up", "--gate", "human", "--lockstep"],
        &["--gate human needs real time; drop --lockstep"],
    );
    assert_refused(
        &["up", "--gate", "human", "--set", "run.clock=lockstep"],
        &["a person needs real time"],
    );
    assert_refused(
        &["train", "--out", "nope/x"],
        &["--out nope/x", "nope is not a folder"],
    );
    for words in [["--run", &long], ["--set", &long]] {
        let folder = tempfile::tempdir().expect("a folder");
        let text = said(&vlaps(folder.path(), &[&["up"], &words[..]].concat()));
        assert!(!text.contains(&long) && text.contains("aaa…"), "{text}");
        assert!(text.len() < 350, "{text}");
    }
}

#[test]
fn help_and_usage_name_what_there_is() {
    let folder = tempfile::tempdir().expect("a folder");
    let help = |words: &[&str]| said(&vlaps(folder.path(), words));
    let whole = help(&["--help"])
        .split_whitespace()
        .collect::<Vec<_>>()
        .join(" ");
    for line in help(&["bench", "--help"]).lines() {
        let word = line
            .strip_prefix("  ")
            .and_then(|line| line.split_whitespace().next());
        let is_bench = line.starts_with("  ") && !line.starts_with("   ");
        if let Some(word) =
            word.filter(|word| is_bench && *word != "help" && !word.starts_with('-'))
        {
            assert!(whole.contains(word), "'{word}' is missing in: {whole}");
        }
    }
    // The lines are as wide as the terminal.
    let down = help(&["down", "--help"]);
    let down: Vec<_> = down.split_whitespace().collect();
    assert!(down.join(" ").contains("status and swap exit 1"));
    assert!(help(&["judge", "serve", "--qqq"]).contains("./vlaps judge serve [OPTIONS]"));
}

#[test]
fn an_evaluation_says_on_how_many_threads_it_ran() {
    let folder = tempfile::tempdir().expect("a folder");
    let words = [
        "eval",
        "--episodes",
        "1",
        "--driver",
        "idm",
        "--threads",
        "100000",
    ];
    let text = said(&vlaps(folder.path(), &words));
    assert!(text.contains("1 episode on 1 thread in"), "{text}");
    assert!(text.contains("--threads 100000: with"), "{text}");
    let words = [
        "draw", "episode", "--seed", "3", "--driver", "idm", "--out", "a.svg",
    ];
    let output = vlaps(folder.path(), &words);
    assert!(output.status.success(), "{output:?}");
    let svg = fs::read_to_string(folder.path().join("a.svg")).expect("a picture");
    let legend = ["traffic path", "last scan", "fill-opacity=\"0.35\""];
    assert!(legend.iter().all(|part| svg.contains(part)));
}

#[test]
fn a_folder_that_is_read_only_is_the_same_failure_everywhere() {
    let read_only = "mount -t tmpfs -o ro tmpfs /mnt && cd /mnt && exec \"$0\" \"$@\"";
    let wrapper = [&SMALL[..], &[read_only]].concat();
    if skip_unless(&[&wrapper[..], &["true"]].concat(), NAMESPACES) {
        return;
    }
    for (name, words) in [
        (
            "vlaps-supervisor",
            &["up", "--lockstep", "--episodes", "1"][..],
        ),
        ("vlaps-supervisor", &["status", "--json", "s.json"]),
        ("vlaps-lab", &["train", "--out", "x", "--steps", "200"]),
    ] {
        let mut command = Command::new(wrapper[0]);
        let command = command.args(&wrapper[1..]).arg(programs().join(name));
        let run = format!("n{}-ro", std::process::id());
        let run: &[&str] = match words[0] {
            "train" => &[],
            _ => &["--run", &run],
        };
        let output = command.args(words).args(run).output().expect("unshare");
        let text = said(&output);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {text}");
        assert!(text.contains("Read-only file system"), "{words:?}: {text}");
    }
}

#[test]
fn a_plain_run_has_enough_of_a_containers_shared_memory_and_refuses_too_little() {
    let mount =
        |size: &str| format!("mount -t tmpfs -o size={size} tmpfs /dev/shm && exec \"$0\" \"$@\"");
    let usual = mount("64m");
    let probe = [&SMALL[..], &[&usual, "true"]].concat();
    if skip_unless(&probe, NAMESPACES) {
        return;
    }
    let words = ["--lockstep", "--episodes", "2", "--seed", "3"];
    let up = |set: &Set, size: &str| {
        let mount = mount(size);
        let wrapper = [&SMALL[..], &[&mount]].concat();
        let mut command = set.up_command(&wrapper, &words);
        command.output().expect("unshare")
    };
    let set = Set::new("small");
    let output = up(&set, "64m");
    assert!(output.status.success(), "{}\n{}", said(&output), set.logs());
    assert_eq!(set.json()["episodes"].as_array().map(Vec::len), Some(2));
    let set = Set::new("tiny");
    let output = up(&set, "1m");
    let text = said(&output);
    assert_eq!(output.status.code(), Some(2), "{text}");
    let line = text
        .lines()
        .find(|line| line.starts_with("error: "))
        .expect("an error");
    for part in [
        "/dev/shm: ",
        " MB free, the run needs ",
        "(steps 25, weights",
        "--shm-size",
    ] {
        assert!(line.contains(part), "'{part}' is missing in: {line}");
    }
}

#[test]
fn a_run_whose_reader_goes_away_stops_in_order() {
    let set = Set::new("unread");
    let mut command = set.up_command(&[], &["--seed", "3", "--no-realtime"]);
    let command = command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut up = command.spawn().expect("it starts");
    let mut first = String::new();
    let mut reader = BufReader::new(up.stdout.take().expect("its output"));
    reader.read_line(&mut first).expect("a line");
    drop(reader);
    let output = up.wait_with_output().expect("it ends");
    let text = said(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("a pipe without a reader"), "{text}");
    let json = set.json();
    assert!(
        json["ended"]
            .as_str()
            .is_some_and(|ended| ended.starts_with("given up: its output"))
    );
    assert!(json["ticks"].as_u64() > Some(0), "{json}");
    assert!(
        set.logs().contains("giving up: its output"),
        "{}",
        set.logs()
    );
}

#[test]
fn status_tells_restarts_and_the_latest_ticks() {
    let mut set = Set::new("late");
    set.start(&[
        "--seed",
        "3",
        "--no-realtime",
        "--set",
        "supervisor.silence_s=60",
    ]);
    let ticks = |process: &str| set.status_of(process)["ticks"].as_u64();
    until("the controller ticks", || ticks("controller") > Some(5));
    assert_eq!(set.status_of("planner")["restarts"], 0);
    set.signal_program("vlaps-planner", Signal::KILL);
    until("the planner's restart is told", || {
        set.status_of("planner")["restarts"] == 1
    });
    assert!(set.status().0.contains("restarts"));
    // A controller that is stopped for some ticks completes them late.
    let before = ticks("world");
    set.signal_program("vlaps-controller", Signal::STOP);
    until("the world goes on", || {
        ticks("world") > before.map(|ticks| ticks + 6)
    });
    set.signal_program("vlaps-controller", Signal::CONT);
    let is_told = |json: &Value| {
        let rows = json["late_ticks"].as_array().cloned().unwrap_or_default();
        rows.iter().any(|row| {
            let late_us = row["late_us"].as_f64().unwrap_or(0.0);
            row["process"] == "controller" && late_us > 4e5 && row["skipped"].as_u64() > Some(3)
        })
    };
    until("status tells the late tick", || is_told(&set.status().1));
    set.signal(Signal::TERM);
    assert_eq!(set.wait(), Some(0));
    let json = set.json();
    assert!(is_told(&json), "{json}");
    let rows = json["late_ticks"].as_array().expect("late ticks");
    assert!(rows.len() <= 20);
    let late_us = rows
        .iter()
        .map(|row| row["late_us"].as_f64().expect("a number"));
    assert!(
        late_us.is_sorted_by(|later, less| later >= less),
        "{rows:?}"
    );
    let part = |row: &Value| row["part"].as_str().is_some() && row["part_us"].as_f64() >= Some(0.0);
    assert!(rows.iter().all(part), "{rows:?}");
}

#[test]
fn lockstep_has_no_late_ticks_and_its_summary_says_what_ended_it() {
    let set = Set::new("unasked");
    let words = [
        "--lockstep",
        "--seed",
        "3",
        "--duration",
        "3",
        "--late-ticks",
        "--gate",
        "vlm",
        "--set",
        "vlm.model=vlaps-stand-in",
        "--set",
        "vlm.server=http://127.0.0.1:9/v1",
    ];
    let output = set.run(&words);
    let text = said(&output);
    assert!(output.status.success(), "{text}\n{}", set.logs());
    let reason = "never asked: no policy is loaded; add --policy FILE.onnx";
    for part in [
        &format!("judge: {reason}")[..],
        "stopped: the run ended before the episode",
        "no tick was late",
        "world: ticks 30 + skipped 0 = 30 == 30 = elapsed 3.000 s / period 0.1 s",
        "planner: ticks 30 + skipped 0 = 30 == 30",
        "controller: ticks 30 + skipped 0 = 30 == 30",
    ] {
        assert!(text.contains(part), "'{part}' is missing in: {text}");
    }
    let json = set.json();
    assert_eq!(json["judge_unasked"], reason);
    assert_eq!(json["late_ticks"], Value::Array(Vec::new()));
}

#[test]
fn a_persons_share_is_told_apart_from_the_experts() {
    let set = Set::new("person");
    fs::write(set.folder().join("keys.txt"), "1 space\n").expect("keys");
    let words = [
        "--gate",
        "human",
        "--keys",
        "keys.txt",
        "--duration",
        "4",
        "--no-realtime",
    ];
    let output = set.run(&words);
    let text = said(&output);
    assert!(output.status.success(), "{text}\n{}", set.logs());
    assert!(text.contains("drove: human driver "), "{text}");
    let json = set.json();
    let (person, expert) = (
        json["person_share"].as_f64(),
        json["share"]["expert"].as_f64(),
    );
    assert!(person > Some(0.4) && person <= expert, "{json}");
}
