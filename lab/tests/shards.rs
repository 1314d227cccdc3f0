//! Work in parts: killed, resumed, merged; the figures are those of one piece.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use lab::replay::rehearsal::{Rehearsal, policy_file};
use serde_json::Value;
use tempfile::TempDir;

/// Interval of the checks of what a child has kept.
const LOOK: Duration = Duration::from_millis(2);

fn lab(words: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vlaps-lab"));
    command
        .args(words)
        .env("VLAPS_COMMIT", "0123abc")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped());
    command
}

fn run(words: &[&str]) -> Output {
    lab(words).output().expect("the program starts")
}

fn said(output: &Output) -> String {
    let text = [&output.stdout[..], &output.stderr].concat();
    String::from_utf8_lossy(&text).into_owned()
}

fn json(path: &Path) -> Value {
    let text = fs::read_to_string(path).expect("the JSON was written");
    let mut value: Value = serde_json::from_str(&text).expect("JSON");
    // The only figure that is a time of this machine.
    value
        .as_object_mut()
        .map(|figures| figures.remove("planning_p99_us"));
    value
}

/// An evaluation in parts, in a folder of its own.
struct Parts {
    place: TempDir,
    options: Vec<String>,
    of: u32,
}

impl Parts {
    fn new(driver: &str, episodes: u64, of: u32) -> Parts {
        let options = format!("--driver {driver} --episodes {episodes} --first-seed 1000");
        Parts {
            place: TempDir::new().expect("a folder"),
            options: options.split(' ').map(String::from).collect(),
            of,
        }
    }

    fn out(&self) -> PathBuf {
        self.place.path().join("out")
    }

    fn file(&self, shard: u32) -> PathBuf {
        self.out()
            .join(format!("shard-{shard}-of-{}.jsonl", self.of))
    }

    /// The command of a part, with further options.
    fn shard(&self, shard: u32, more: &[&str]) -> Command {
        let mut command = lab(&["eval"]);
        command
            .args(&self.options)
            .args(["--shard".into(), format!("{shard}/{}", self.of)]);
        command.arg("--out").arg(self.out()).args(more);
        command
    }

    fn drive(&self, shard: u32) -> String {
        let output = self.shard(shard, &[]).output().expect("it starts");
        assert!(output.status.success(), "{output:?}");
        said(&output)
    }

    /// Starts a part and waits until it has kept some episodes.
    fn start(&self, shard: u32, kept: usize) -> Child {
        let mut child = self
            .shard(shard, &["--threads", "1"])
            .spawn()
            .expect("it starts");
        while self.lines(shard) < kept + 1 {
            let ended = child.try_wait().expect("a child");
            assert!(ended.is_none(), "it ended early: {ended:?}");
            supervisor::machine::signals::pause(LOOK);
        }
        child
    }

    fn lines(&self, shard: u32) -> usize {
        let text = fs::read_to_string(self.file(shard)).unwrap_or_default();
        text.matches('\n').count()
    }

    /// The report with its exit code and figures.
    fn report(&self) -> (Option<i32>, String, Option<Value>) {
        let file = self.place.path().join("report.json");
        let _ = fs::remove_file(&file);
        let mut command = lab(&["eval", "--report", "--out"]);
        command.arg(self.out()).arg("--json").arg(&file);
        let output = command.output().expect("it starts");
        (
            output.status.code(),
            said(&output),
            file.exists().then(|| json(&file)),
        )
    }

    /// The figures of one piece.
    fn one_piece(&self) -> Value {
        let file = self.place.path().join("one.json");
        let mut command = lab(&["eval"]);
        command.args(&self.options).arg("--json").arg(&file);
        let output = command.output().expect("it starts");
        assert!(output.status.success(), "{output:?}");
        json(&file)
    }
}

#[test]
fn parts_that_are_killed_and_resumed_make_the_figures_of_one_piece() {
    // Planners take a second for an episode, MetaDrive's driver some milliseconds.
    for (driver, episodes) in [("rrt-star", 16), ("idm", 1_200)] {
        let parts = Parts::new(driver, episodes, 4);
        let each = (episodes / 4) as usize;
        for shard in [1, 3] {
            let mut child = parts.start(shard, 2);
            child.kill().expect("killed");
            child.wait().expect("an end");
            let kept = parts.lines(shard) - 1;
            assert!(
                (2..each).contains(&kept),
                "{driver}: killed after {kept} episodes"
            );
            let told = parts.drive(shard);
            assert!(
                told.contains(&format!("complete, {each} episodes")),
                "{told}"
            );
            // No episode was driven twice.
            assert_eq!(parts.lines(shard), each + 1, "{driver}");
        }
        let (code, told, partial) = parts.report();
        assert_eq!(code, Some(1), "{told}");
        let half = 2 * each;
        let words = format!("{half} of {episodes} episodes missing, of shards 2/4, 4/4");
        assert!(told.contains(&words), "{told}");
        assert_eq!(partial.expect("figures")["missing"]["pieces"], half);
        parts.drive(2);
        parts.drive(4);
        let (code, told, merged) = parts.report();
        assert_eq!(code, Some(0), "{told}");
        assert_eq!(merged, Some(parts.one_piece()), "{driver}");
    }
}

#[test]
fn a_finished_part_changes_nothing_and_says_so() {
    let parts = Parts::new("lane", 6, 2);
    parts.drive(1);
    let before = fs::read(parts.file(1)).expect("the part");
    let told = parts.drive(1);
    assert!(told.contains("complete already, 3 episodes"), "{told}");
    assert_eq!(fs::read(parts.file(1)).expect("the part"), before);
}

#[test]
fn a_stop_request_keeps_what_is_finished() {
    let parts = Parts::new("rrt-star", 100, 1);
    let child = parts.start(1, 1);
    let id = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(id, rustix::process::Signal::TERM).expect("it lives");
    let output = child.wait_with_output().expect("an end");
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let told = said(&output);
    assert!(
        told.contains("of 100 episodes of shard 1/1; the same command"),
        "{told}"
    );
    let (_, told, figures) = parts.report();
    let missing = figures.expect("figures")["missing"]["pieces"].as_u64();
    assert_eq!(missing, Some(101 - parts.lines(1) as u64), "{told}");
}

#[test]
fn a_part_that_is_worked_on_is_refused_to_a_second_process() {
    let parts = Parts::new("rrt-star", 1000, 1);
    let mut child = parts.start(1, 1);
    let output = parts.shard(1, &[]).output().expect("it starts");
    child.kill().expect("killed");
    child.wait().expect("an end");
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    assert!(
        said(&output).contains("another process works on this shard"),
        "{output:?}"
    );
}

#[test]
fn a_part_of_other_work_is_refused_with_the_option() {
    let parts = Parts::new("lane", 4, 2);
    parts.drive(1);
    let before = fs::read(parts.file(1)).expect("the part");
    let refused = |mut command: Command, hint: &str| {
        let output = command.output().expect("it starts");
        assert_eq!(output.status.code(), Some(2), "{hint}: {output:?}");
        assert!(said(&output).contains(hint), "{hint}: {}", said(&output));
    };
    for (more, hint) in [
        (["--episodes", "6"], "--episodes 4, not 6"),
        (["--first-seed", "7"], "--first-seed 1000, not 7"),
        (["--driver", "idm"], "--driver lane, not idm"),
        (["--set", "world.blocks=5"], "world.blocks"),
        (["--shard", "2/4"], "number of shards 2, not 4"),
    ] {
        let mut words: Vec<String> = parts.options.clone();
        match words.iter().position(|word| word == more[0]) {
            Some(at) => words[at + 1] = more[1].into(),
            None if more[0] != "--shard" => words.extend(more.map(String::from)),
            None => {}
        }
        let shard = if more[0] == "--shard" { more[1] } else { "2/2" };
        let mut command = lab(&["eval", "--shard", shard]);
        command.args(&words).arg("--out").arg(parts.out());
        refused(command, hint);
    }
    let mut other_build = parts.shard(2, &[]);
    other_build.env("VLAPS_COMMIT", "fedcba9");
    refused(other_build, "commit 0123abc, not fedcba9");
    let mut other_command = lab(&["train", "--report", "--out"]);
    other_command.arg(parts.out());
    refused(other_command, "is a shard of ./vlaps eval");
    assert_eq!(fs::read(parts.file(1)).expect("the part"), before);
    assert_eq!(
        fs::read_dir(parts.out()).expect("files").count(),
        4,
        "a lock each"
    );
}

#[test]
fn damaged_and_foreign_files_are_named_and_counted_as_missing() {
    let parts = Parts::new("lane", 9, 3);
    (1..=3).for_each(|shard| drop(parts.drive(shard)));
    let whole = parts.report().2;
    // A torn line, a flipped byte, a foreign file.
    let text = fs::read(parts.file(1)).expect("the part");
    fs::write(parts.file(1), &text[..text.len() - 7]).expect("written");
    let mut flipped = fs::read(parts.file(2)).expect("the part");
    let at = flipped.len() - 20;
    flipped[at] ^= 1;
    fs::write(parts.file(2), flipped).expect("written");
    fs::write(parts.file(3), "my notes").expect("written");
    fs::write(parts.out().join("README.txt"), "mine").expect("written");
    let (code, told, _) = parts.report();
    assert_eq!(code, Some(1), "{told}");
    for words in [
        "shard-2-of-3.jsonl: 1 line cannot be used (line 4",
        "shard-3-of-3.jsonl: cannot be used (has no complete header)",
        "5 of 9 episodes missing, of shards 1/3 (1 of 3 episodes), 2/3 (1 of 3 episodes), 3/3;",
    ] {
        assert!(told.contains(words), "{words}: {told}");
    }
    (1..=3).for_each(|shard| drop(parts.drive(shard)));
    assert_eq!(parts.report().2, whole);
    // What was damaged is still there.
    let kept = parts.out().join("shard-3-of-3.jsonl.damaged");
    assert_eq!(fs::read_to_string(kept).expect("the copy"), "my notes");
}

/// A line of a part's file with its checksum.
fn line(text: &str) -> String {
    let sum = crc32c::crc32c(text.as_bytes());
    format!("[\"{sum:08x}\", {text}]")
}

/// Replaces a text in the line of a piece, which may stand anywhere in the file, or in the
/// header, and gives the line a right checksum.
fn craft(file: &Path, piece: Option<u64>, (was, now): (&str, &str)) {
    let text = fs::read_to_string(file).expect("the part");
    let mut lines: Vec<String> = text.lines().map(String::from).collect();
    let number = piece.map_or(0, |piece| {
        let of_piece = format!("{{\"piece\":{piece},");
        let number = lines.iter().position(|line| line.contains(&of_piece));
        number.expect("a line of the piece")
    });
    let (_, value) = lines[number].split_once("\", ").expect("a line");
    let value = value.strip_suffix(']').expect("a line");
    assert!(value.contains(was), "{value}");
    lines[number] = line(&value.replace(was, now));
    fs::write(file, lines.join("\n") + "\n").expect("written");
}

#[test]
fn results_of_another_seed_are_named_and_driven_again() {
    let parts = Parts::new("lane", 4, 2);
    (1..=2).for_each(|shard| drop(parts.drive(shard)));
    let whole = parts.report().2;
    craft(&parts.file(1), Some(1), ("\"seed\":1001", "\"seed\":1000"));
    craft(&parts.file(2), Some(2), ("\"outcome\":", "\"outcome\":99"));
    let (code, told, _) = parts.report();
    assert_eq!(code, Some(1), "{told}");
    for words in [
        "piece 1 cannot be used (seed 1000",
        "piece 2 cannot be used (seed 1002",
        "2 of 4 episodes missing",
    ] {
        assert!(told.contains(words), "{words}: {told}");
    }
    (1..=2).for_each(|shard| drop(parts.drive(shard)));
    assert_eq!(parts.report().2, whole);
}

#[test]
fn a_crafted_header_neither_hangs_a_report_nor_ends_it_with_a_panic() {
    let parts = Parts::new("lane", 4, 1);
    parts.drive(1);
    let header = fs::read(parts.file(1)).expect("the part");
    let report = |command: &str| {
        let output = lab(&[command, "--report", "--out"])
            .arg(parts.out())
            .output();
        let output = output.expect("it starts");
        (output.status.code(), said(&output))
    };
    for (pieces, hint) in [
        ("9223372036854775808", "are possible"),
        ("0", "are possible"),
        ("5", "the shards name 5 pieces, where their options make 4"),
    ] {
        craft(
            &parts.file(1),
            None,
            ("\"pieces\":4", &format!("\"pieces\":{pieces}")),
        );
        let (code, told) = report("eval");
        assert!(matches!(code, Some(1 | 2)), "{code:?}: {told}");
        assert!(told.contains(hint), "{told}");
        fs::write(parts.file(1), &header).expect("written");
    }
    let sweep = "\"command\":\"sweep\",\"--seed\":\"0\",\"--seeds\":\"0\"";
    craft(&parts.file(1), None, ("\"command\":\"eval\"", sweep));
    let (code, told) = report("sweep");
    assert!(matches!(code, Some(1 | 2)), "{code:?}: {told}");
    assert!(told.contains("their options make 0"), "{told}");
}

#[test]
fn folders_of_two_machines_are_copied_together() {
    let (here, there) = (Parts::new("lane", 7, 2), Parts::new("lane", 7, 2));
    here.drive(1);
    there.drive(2);
    fs::copy(there.file(2), here.file(2)).expect("copied");
    // The same part twice: it has one name, and counts once.
    fs::copy(here.file(1), there.file(1)).expect("copied");
    let (code, told, merged) = here.report();
    assert_eq!(
        (code, &merged),
        (Some(0), &Some(here.one_piece())),
        "{told}"
    );
    assert_eq!(there.report().2, merged);
}

#[test]
fn mistakes_are_told() {
    let place = TempDir::new().expect("a folder");
    let out = place.path().join("none");
    let out = out.to_str().expect("UTF-8");
    for (words, hint) in [
        (&["eval", "--shard", "1/2"][..], "--out"),
        (&["eval", "--shard", "0/2", "--out", out], "such as 1/8"),
        (&["eval", "--shard", "3/2", "--out", out], "such as 1/8"),
        (&["eval", "--out", out], "--shard I/N"),
        (&["eval", "--report"], "--out"),
        (&["eval", "--report", "--out", out], "contains no shard"),
        (
            &["eval", "--report", "--out", out, "--driver", "idm"],
            "--driver",
        ),
        (
            &["eval", "--shard", "1/2", "--out", out, "--json", "a.json"],
            "--json",
        ),
        (&["train", "--shard", "1/2"], "--out"),
        (&["sweep", "--shard", "1/2"], "--out"),
        (&["regress", "--report", "--out", out], "contains no shard"),
        (&["regress", "--out", out, "--shard", "1/2"], "FOLDER"),
    ] {
        let output = run(words);
        assert_eq!(output.status.code(), Some(2), "{words:?}: {output:?}");
        assert!(said(&output).contains(hint), "{words:?}: {}", said(&output));
        assert!(!Path::new(out).exists(), "{words:?}");
    }
}

#[test]
fn a_regression_in_parts_has_the_rows_of_one_piece() {
    let place = TempDir::new().expect("a folder");
    let folder = place.path().join("recordings");
    for seed in 0..3_u64 {
        let folder = folder.join(seed.to_string());
        fs::create_dir_all(&folder).expect("a folder");
        let run = Rehearsal::troubled(seed).and_then(|run| run.run(300));
        let saved = run.and_then(|run| run.save(&folder.join("run-0001.mcap")));
        saved.expect("a recording");
    }
    let policy = place.path().join("policy.onnx");
    fs::write(&policy, policy_file(9).expect("a policy").bytes).expect("written");
    let [out, one, merged] = ["out", "one.json", "merged.json"].map(|name| place.path().join(name));
    let options = [
        &folder.display().to_string(),
        "--policy",
        &policy.display().to_string(),
    ];
    let options = [&options[..], &["--seconds", "2", "--lead", "1"]].concat();
    let mut command = lab(&["regress"]);
    let output = command
        .args(&options)
        .arg("--json")
        .arg(&one)
        .output()
        .expect("it starts");
    let expected = output.status.code();
    for shard in ["1/3", "2/3", "3/3", "2/3"] {
        let mut command = lab(&["regress", "--shard", shard, "--out"]);
        let output = command
            .arg(&out)
            .args(&options)
            .output()
            .expect("it starts");
        assert!(output.status.success(), "{output:?}");
    }
    let mut command = lab(&["regress", "--report", "--out"]);
    let output = command
        .arg(&out)
        .arg("--json")
        .arg(&merged)
        .output()
        .expect("it starts");
    assert_eq!(output.status.code(), expected, "{}", said(&output));
    let (mut one, mut merged) = (json(&one), json(&merged));
    assert!(one["rows"].as_array().expect("rows").len() > 3, "{one}");
    for figures in [&mut one, &mut merged] {
        // Times of this machine.
        figures["elapsed_s"] = Value::Null;
        figures["forks_per_minute"] = Value::Null;
    }
    assert_eq!(merged, one);
}
