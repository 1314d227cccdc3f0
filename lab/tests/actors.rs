//! `./vlaps train --actors`: the policies are the same for any number of actors, when actors
//! are killed or stopped, and when the training itself is killed and resumed.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use supervisor::machine::signals::pause;
use tempfile::TempDir;

/// Steps of a block; an episode has 60 at most.
const BLOCK: u64 = 150;
/// Blocks of a training that is disturbed.
const BLOCKS: u64 = 12;
const LOOK: Duration = Duration::from_millis(5);
/// Looks until a test gives up: two minutes, of which a busy machine needs a few seconds.
const LOOKS: u32 = 24_000;

/// A training in a folder of its own.
struct Training {
    place: TempDir,
    child: Option<Child>,
}

impl Training {
    fn new() -> Training {
        Training {
            place: TempDir::new().expect("a folder"),
            child: None,
        }
    }

    fn out(&self) -> PathBuf {
        self.place.path().join("out")
    }

    /// Small nets; imagined scenes, so that the learner draws random numbers with each step.
    fn command(&self, actors: u32) -> Command {
        let mut command = self.resume(&[]);
        let words = "--algorithm ppl --expert informed --eval-episodes 1 --final-episodes 0 \
                     --set learner.updates=5 --set learner.batch=16 --set learner.hidden=16 \
                     --set world.horizon_ticks=60 --set learner.predicted_states=1 \
                     --set learner.imagined_scenes=1";
        command
            .args(words.split_whitespace())
            .args(["--set", &format!("learner.block_steps={BLOCK}")])
            .args(["--steps", &(BLOCK * BLOCKS).to_string()])
            .args(["--actors", &actors.to_string()]);
        command
    }

    fn resume(&self, words: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_vlaps-lab"));
        command
            .args(["train", "--out"])
            .arg(self.out())
            .args(words)
            .env("VLAPS_COMMIT", "0123abc")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    fn start(&mut self, mut command: Command) {
        self.child = Some(command.spawn().expect("it starts"));
    }

    fn end(&mut self) -> Output {
        let child = self.child.take().expect("a training");
        child.wait_with_output().expect("an end")
    }

    fn policies(&self) -> BTreeMap<String, Vec<u8>> {
        let folder = self.out().join("seed-0/learner/policies");
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let files =
            entries.filter(|entry| entry.path().extension().is_some_and(|end| end == "onnx"));
        files
            .map(|entry| {
                let name = entry.file_name().to_string_lossy().into_owned();
                (name, fs::read(entry.path()).expect("a policy"))
            })
            .collect()
    }

    /// Waits until so many blocks are learnt.
    fn await_blocks(&self, count: usize) {
        await_that(&format!("{count} blocks"), || {
            (self.policies().len() >= count).then_some(())
        });
    }

    /// The processes of its actors.
    fn actors(&self) -> Vec<Pid> {
        let training = self.child.as_ref().expect("a training").id();
        let mark = format!("actor\0--parent\0{training}\0");
        let entries = fs::read_dir("/proc").expect("/proc").flatten();
        let pids = entries.filter_map(|entry| {
            let pid = entry.file_name().to_string_lossy().parse().ok()?;
            let words = fs::read(entry.path().join("cmdline")).ok()?;
            let is_it = words
                .windows(mark.len())
                .any(|part| part == mark.as_bytes());
            is_it.then(|| Pid::from_raw(pid)).flatten()
        });
        pids.collect()
    }

    fn signal_actor(&self, signal: Signal) -> Pid {
        let pid = await_that("an actor", || self.actors().first().copied());
        kill_process(pid, signal).expect("it lives");
        pid
    }

    fn tally(&self) -> Value {
        let text = fs::read_to_string(self.out().join("seed-0/actors.json")).expect("a tally");
        serde_json::from_str(&text).expect("JSON")
    }
}

impl Drop for Training {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            let _ = child.kill();
            let _ = child.wait();
        }
    }
}

fn await_that<T>(what: &str, mut look: impl FnMut() -> Option<T>) -> T {
    for _ in 0..LOOKS {
        if let Some(found) = look() {
            return found;
        }
        pause(LOOK);
    }
    panic!("{what}: did not come");
}

fn said(output: &Output) -> String {
    let text = [&output.stdout[..], &output.stderr].concat();
    String::from_utf8_lossy(&text).into_owned()
}

/// The policies of a training that nothing disturbs.
fn undisturbed(actors: u32) -> BTreeMap<String, Vec<u8>> {
    let training = Training::new();
    let output = training.command(actors).output().expect("it starts");
    assert!(output.status.success(), "{}", said(&output));
    let policies = training.policies();
    assert_eq!(policies.len() as u64, BLOCKS, "{}", said(&output));
    policies
}

fn assert_same(ours: &BTreeMap<String, Vec<u8>>, theirs: &BTreeMap<String, Vec<u8>>, what: &str) {
    assert_eq!(ours.len(), theirs.len(), "{what}");
    for (name, policy) in ours {
        assert!(theirs.get(name) == Some(policy), "{what}: {name} differs");
    }
}

fn sum(tally: &Value, key: &str) -> u64 {
    let actors = tally["actors"].as_object().expect("actors");
    actors
        .values()
        .filter_map(|actor| actor[key].as_u64())
        .sum()
}

#[test]
fn the_number_of_actors_and_their_deaths_change_no_policy() {
    let one = undisturbed(1);
    let all: Vec<&Vec<u8>> = one.values().collect();
    assert!(all.windows(2).all(|pair| pair[0] != pair[1]), "it learns");
    assert_same(&one, &undisturbed(8), "8 actors");

    let mut killed = Training::new();
    killed.start(killed.command(2));
    for blocks in [1, 4] {
        killed.await_blocks(blocks);
        killed.signal_actor(Signal::KILL);
    }
    let output = killed.end();
    assert!(output.status.success(), "{}", said(&output));
    let tally = killed.tally();
    assert_eq!(sum(&tally, "deaths"), 2, "{tally}");
    let learnt = sum(&tally, "transitions") - tally["surplus"].as_u64().expect("a count");
    assert_eq!(learnt, BLOCK * BLOCKS, "{tally}");
    for words in ["actor 0", "actor 1", "doubles ignored", "refused: none"] {
        assert!(said(&output).contains(words), "{words}: {}", said(&output));
    }
    assert_same(&one, &killed.policies(), "2 actors, killed twice");
}

#[test]
fn a_stopped_actor_delays_its_episode_and_changes_no_policy() {
    let one = undisturbed(2);
    let mut stopped = Training::new();
    stopped.start(stopped.command(2));
    stopped.await_blocks(1);
    let pid = stopped.signal_actor(Signal::STOP);
    // Another actor drives its episode, if it had one, and all later ones.
    let learnt = stopped.policies().len();
    stopped.await_blocks(learnt + 3);
    kill_process(pid, Signal::CONT).expect("it lives");
    let output = stopped.end();
    assert!(output.status.success(), "{}", said(&output));
    assert_same(&one, &stopped.policies(), "a stopped actor");
}

#[test]
fn a_killed_training_goes_on_and_learns_the_same_policies() {
    let one = undisturbed(2);
    let mut killed = Training::new();
    killed.start(killed.command(2));
    for blocks in [1, 3, 6] {
        killed.await_blocks(blocks);
        let actors = killed.actors();
        let child = killed.child.as_mut().expect("a training");
        child.kill().expect("it lives");
        killed.end();
        await_that("the end of its actors", || {
            let ended = |pid: &Pid| !Path::new(&format!("/proc/{}", pid.as_raw_nonzero())).exists();
            actors.iter().all(ended).then_some(())
        });
        killed.start(killed.resume(&["--resume"]));
    }
    let output = killed.end();
    assert!(output.status.success(), "{}", said(&output));
    assert_same(&one, &killed.policies(), "killed and resumed");
    let output = killed.resume(&["--resume", "--actors", "3"]).output();
    let output = output.expect("it starts");
    assert!(output.status.success(), "{}", said(&output));
    assert_same(&one, &killed.policies(), "nothing was left");
}

#[test]
fn what_an_actor_cannot_drive_is_refused_before_it_starts() {
    let training = Training::new();
    for (words, hint) in [
        ("--set gate.mode=vlm", "no judge"),
        ("--world metadrive", "built-in world"),
    ] {
        let mut command = training.command(1);
        let output = command.args(words.split(' ')).output().expect("it starts");
        assert_eq!(output.status.code(), Some(2), "{words}: {}", said(&output));
        assert!(said(&output).contains(hint), "{words}: {}", said(&output));
    }
    let output = Command::new(env!("CARGO_BIN_EXE_vlaps-lab"))
        .arg("actor")
        .stdin(Stdio::null())
        .output()
        .expect("it starts");
    assert!(!output.status.success());
}
