//! The set that a bare `down` or `swap` selects: the one of this folder, or none.

use std::fs;
use std::process::{Command, Output};

use vlaps_tests::two_users::text;
use vlaps_tests::{Set, programs, until};

const DRIVE: [&str; 7] = [
    "--no-realtime",
    "--rate",
    "10",
    "--gate",
    "expert",
    "--seed",
    "3",
];

/// A command of `vlaps` in the folder of a set.
fn vlaps(set: &Set, words: &[&str]) -> Output {
    let mut command = Command::new(programs().join("vlaps-supervisor"));
    command.args(words).current_dir(set.folder());
    command.output().expect("it runs")
}

fn assert_refused(output: &Output, parts: &[&str]) {
    let said = text(output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    for part in parts {
        assert!(said.contains(part), "'{part}' is missing in: {said}");
    }
}

fn await_driving(set: &Set) {
    until("the set drives", || set.logs().contains("world: ready"));
}

#[test]
fn a_bare_command_takes_this_folders_set_alone() {
    let mut set = Set::new("own");
    let elsewhere = Set::new("else");
    set.start(&DRIVE);
    await_driving(&set);
    fs::write(elsewhere.folder().join("a.onnx"), "no policy").expect("written");
    fs::write(set.folder().join("a.onnx"), "no policy").expect("written");
    let name = set.name().to_string();
    let named = ["no set of this folder runs", &name, "--run NAME"];
    assert_refused(&vlaps(&elsewhere, &["down"]), &named);
    assert_refused(&vlaps(&elsewhere, &["swap", "a.onnx"]), &named);
    // The policy was offered to this set, whose controller read it.
    let swapped = text(&vlaps(&set, &["swap", "a.onnx"]));
    assert!(swapped.contains("a.onnx: refused: "), "{swapped}");
    let seen = text(&vlaps(&elsewhere, &["status"]));
    assert!(seen.contains(&name), "status shows all: {seen}");
    let stopped = vlaps(&set, &["down"]);
    assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped));
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
}

#[test]
fn a_set_that_another_program_drives_is_stopped_by_its_name_alone() {
    let mut set = Set::new("child");
    let parent = std::process::id().to_string();
    set.start(&[&DRIVE[..], &["--parent", &parent]].concat());
    await_driving(&set);
    let driven = format!("of process {parent}, which drives it");
    let name = set.name().to_string();
    assert_refused(&vlaps(&set, &["down"]), &["no set of this folder", &driven]);
    let stopped = vlaps(&set, &["down", "--run", &name]);
    assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped));
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    let gone = vlaps(&set, &["down", "--run", &name]);
    assert_eq!(gone.status.code(), Some(0), "{}", text(&gone));
}

#[test]
fn two_sets_of_one_folder_must_be_named() {
    let mut first = Set::new("two");
    first.start(&DRIVE);
    await_driving(&first);
    let second = format!("{}b", first.name());
    let mut other = Command::new(programs().join("vlaps-supervisor"))
        .args(["up", "--run", &second])
        .args(DRIVE)
        .current_dir(first.folder())
        .stdout(std::process::Stdio::null())
        .spawn()
        .expect("it starts");
    let log = first
        .folder()
        .join(format!("runs/{second}/logs/supervisor.log"));
    until("the second drives", || {
        fs::read_to_string(&log).is_ok_and(|log| log.contains("world: ready"))
    });
    let name = first.name().to_string();
    let parts = ["several sets of this folder run", &name, &second];
    assert_refused(&vlaps(&first, &["down"]), &parts);
    for name in [&second, &name] {
        let stopped = vlaps(&first, &["down", "--run", name]);
        assert_eq!(stopped.status.code(), Some(0), "{}", text(&stopped));
    }
    assert_eq!(other.wait().expect("an end").code(), Some(0));
    assert_eq!(first.wait(), Some(0), "{}", first.logs());
}
