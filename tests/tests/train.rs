//! `./vlaps train` on real process sets: it can be stopped, killed and resumed, and
//! drives exactly the requested steps.

mod experiment;

use std::fs;
use std::path::Path;
use std::process::Command;

use experiment::{BLOCK, Experiment};
use policy::decode;
use rustix::process::{Pid, Signal, kill_process};
use shm_config::config::from_toml;
use vlaps_tests::{programs, until};

/// Blocks of a training that is disturbed: some seconds.
const BLOCKS: u64 = 40;

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn multiples(count: u64) -> Vec<u64> {
    (1..=count).map(|block| block * BLOCK).collect()
}

/// The sum of the ticks in the set's summaries.
fn driven(seed: &Path) -> u64 {
    let entries = fs::read_dir(seed).expect("the seed's folder");
    let ticks = entries.filter_map(|entry| {
        let path = entry.expect("an entry").path();
        let name = path.file_name()?.to_str()?.to_string();
        name.starts_with("summary-").then(|| {
            let text = fs::read_to_string(&path).expect("a summary");
            let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            json["ticks"].as_u64().expect("ticks")
        })
    });
    ticks.sum()
}

#[test]
fn a_training_reports_each_block_in_a_pipe_and_is_refused_a_second_time() {
    let experiment = Experiment::new("lines");
    let steps = (3 * BLOCK).to_string();
    let words = ["--steps", &steps, "--final-episodes", "2"];
    let output = experiment.run(&words);
    assert!(output.status.success(), "{output:?}");
    let said = text(&output.stderr);
    assert!(
        said.contains(&format!("seed 0: {steps} of {steps} steps")),
        "{said}"
    );
    let evaluated = said.lines().filter(|line| line.contains("success "));
    let evaluated: Vec<&str> = evaluated.collect();
    assert!(
        evaluated.iter().all(|line| line.contains(" after step ")),
        "{said}"
    );
    assert!(
        evaluated
            .last()
            .is_some_and(|line| line.ends_with(&format!("after step {steps}"))),
        "{said}"
    );
    assert_eq!(experiment.blocks(0), multiples(3));
    let exams = experiment.column(0, "evaluations.csv", "steps");
    assert_eq!(exams.len(), 3, "{exams:?}");
    for file in [
        "curves.svg",
        "curves.png",
        "table.md",
        "policy.onnx",
        "experiment.toml",
    ] {
        assert!(
            experiment.folder.join(&experiment.name).join(file).exists(),
            "{file}"
        );
    }

    assert_a_policy_is_trained_anew(&experiment);
    assert_a_finished_policy_drives_for_the_next(&experiment);
    assert_other_options_are_refused(&experiment, &words);
    assert_a_longer_training_continues(&experiment);
}

/// `./vlaps relearn` writes a policy beside the training's own, and replaces it only if asked.
fn assert_a_policy_is_trained_anew(experiment: &Experiment) {
    let relearn = |words: &[&str]| {
        let mut command = Command::new(programs().join("vlaps-lab"));
        command.arg("relearn").args(words);
        command.current_dir(&experiment.folder);
        command.output().expect("it starts")
    };
    let file = experiment.seed(0).join("relearnt.onnx");
    let all = ["--set", "learner.algorithm=dagger", "--updates", "20"];
    let output = relearn(&[&[&experiment.name[..]], &all[..]].concat());
    assert!(output.status.success(), "{output:?}");
    assert!(
        text(&output.stderr).contains("20 of 20 updates"),
        "{output:?}"
    );
    let first = fs::read(&file).expect("a policy");
    let origin = decode(&first).expect("a policy file").provenance;
    let origin = origin.expect("ours");
    assert_eq!((&origin.algorithm[..], origin.steps), ("dagger", 3 * BLOCK));

    let output = relearn(&[&experiment.name, "--updates", "30"]);
    assert!(
        text(&output.stdout).contains("--again replaces it"),
        "{output:?}"
    );
    assert!(fs::read(&file).expect("a policy") == first);
    let seed = experiment.seed(0);
    let seed = seed.to_str().expect("a path in UTF-8");
    let output = relearn(&[&[seed, "--again"], &all[..3], &["10"]].concat());
    assert!(output.status.success(), "{output:?}");
    assert!(fs::read(&file).expect("a policy") != first);

    for (words, said) in [
        (&["nowhere"][..], "is no folder"),
        (&["."], "holds no training"),
        (&[&experiment.name, seed], "is named twice"),
        (
            &[seed, "--together", file.to_str().expect("UTF-8")],
            "--again replaces it",
        ),
        (
            &[&experiment.name, "--again", "--set", "learner.batch=1"],
            "learner.batch",
        ),
        (&[&experiment.name, "--updates", "0"], "--updates"),
        (
            &[&experiment.name, "--again", "--set", "learner.motion=true"],
            "without learner.motion",
        ),
    ] {
        let output = relearn(words);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert!(text(&output.stderr).contains(said), "{output:?}");
    }
    assert!(fs::read(&file).expect("a policy") != first);
}

/// Without its training a process set has nothing left to drive: it brakes, and removes its shared
/// memory itself.
#[test]
fn a_training_that_fails_stops_its_set_and_leaves_no_shared_memory() {
    let mut experiment = Experiment::new("damaged");
    experiment.start(&["--steps", "100000"]);
    until("a block", || !experiment.blocks(0).is_empty());
    let rows = experiment.seed(0).join("learner/blocks.csv");
    fs::write(rows, "steps\nmany\n").expect("a file");
    let output = experiment.end();
    assert!(!output.status.success(), "{output:?}");
    assert!(text(&output.stderr).contains("blocks.csv"), "{output:?}");
    assert!(experiment.pids("").is_empty());
    let config = fs::read_to_string(experiment.seed(0).join("train.toml")).expect("the file");
    let config = from_toml(&config, "").expect("a configuration");
    let entries = fs::read_dir("/dev/shm").expect("shared memory");
    let names = entries.map(|entry| entry.expect("an entry").file_name());
    let left = names.filter(|name| name.to_string_lossy().contains(&config.run.name));
    assert_eq!(left.count(), 0);
}

/// A policy that cannot drive is refused before a folder is made.
#[test]
fn a_policy_that_cannot_drive_leaves_no_folder() {
    let experiment = Experiment::new("mistyped");
    let told = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../results/learning/fast-convolved.onnx"
    );
    let told = format!("policy.file={told}");
    for (file, said) in [
        ("learner.updates=0", "name the policy that drives"),
        ("policy.file=mistyped.onnx", "mistyped.onnx: No such file"),
        (&told, "learner.motion=true"),
    ] {
        let output = experiment.run(&["--set", "learner.updates=0", "--set", file]);
        assert_eq!(output.status.code(), Some(2), "{output:?}");
        assert!(text(&output.stderr).contains(said), "{output:?}");
        assert!(!experiment.seed(0).exists(), "{file}");
    }
}

/// With `learner.updates=0` the policy of `policy.file` drives from the first step and stays as it
/// is, also with actors, and `./vlaps relearn` learns from these steps, too.
fn assert_a_finished_policy_drives_for_the_next(experiment: &Experiment) {
    let good = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../results/learning/ppl-50000.onnx"
    );
    let given = fs::read(good).expect("a policy");
    let steps = (2 * BLOCK).to_string();
    for actors in [&[][..], &["--actors", "2"]] {
        let more = Experiment::new("more");
        fs::write(more.folder.join("given.onnx"), &given).expect("a file");
        let mut words = vec!["--final-episodes", "0", "--steps", &steps];
        for key in ["learner.updates=0", "policy.file=given.onnx"] {
            words.extend(["--set", key]);
        }
        let output = more.run(&[&words[..], actors].concat());
        assert!(output.status.success(), "{output:?}");
        assert_eq!(more.blocks(0), multiples(2));
        for steps in multiples(2) {
            let file = format!("learner/policies/{steps:08}.onnx");
            let policy = fs::read(more.seed(0).join(&file)).expect("a policy");
            assert!(policy == given, "{file}");
        }
        // An expert that drives for want of a policy drives all steps of a block.
        let driven = more.column(0, "learner/blocks.csv", "interventions");
        let driven: u64 = driven[1].parse().expect("a number");
        assert!(driven <= BLOCK / 4, "{actors:?}: the expert drove {driven}");

        let mut command = Command::new(programs().join("vlaps-lab"));
        command.current_dir(&more.folder).arg("relearn");
        command.arg(experiment.seed(0)).arg(more.seed(0));
        command.args(["--together", "both.onnx", "--updates", "10"]);
        let output = command.output().expect("it starts");
        assert!(output.status.success(), "{output:?}");
        let both = fs::read(more.folder.join("both.onnx")).expect("a policy");
        let origin = decode(&both).expect("a policy file").provenance;
        assert_eq!(origin.expect("ours").steps, 5 * BLOCK);
    }
}

/// A second start, and a resumed one with other options, are refused with the reason.
fn assert_other_options_are_refused(experiment: &Experiment, words: &[&str]) {
    let output = experiment.run(words);
    assert!(!output.status.success());
    assert!(
        text(&output.stderr).contains("--resume continues"),
        "{output:?}"
    );
    for other in [&["--seed", "7"][..], &["--steps", "40"]] {
        let output = experiment.run(&[other, &["--resume"]].concat());
        assert!(!output.status.success(), "{other:?}");
        assert!(
            text(&output.stderr).contains("contains --seed 0 --seeds 1"),
            "{output:?}"
        );
    }
    let output = experiment.run(&["--resume", "--set", "learner.hidden=16"]);
    assert!(
        text(&output.stderr).contains("learner.hidden = 32, not 16"),
        "{output:?}"
    );

    let output = experiment.resume(&["--algorithm", "pvp"]);
    assert!(
        text(&output.stderr).contains(r#"learner.algorithm = "hg-dagger", not "pvp""#),
        "{output:?}"
    );
}

/// More steps belong to the same experiment, with any configuration file in the folder.
/// The figures of the last policy are then no longer valid and are removed.
fn assert_a_longer_training_continues(experiment: &Experiment) {
    let other = experiment.folder.join("vlaps.toml");
    fs::write(other, "[mpc]\nspeed_mps = 3.0\n").expect("a file");
    let log = experiment.seed(0).join("drive.log");
    let before = fs::read_to_string(&log).expect("the log");
    let longer = (4 * BLOCK).to_string();
    let output = experiment.resume(&["--steps", &longer, "--final-episodes", "0"]);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(experiment.blocks(0), multiples(4));
    assert!(!text(&output.stdout).contains("last policy"), "{output:?}");
    assert_eq!(driven(&experiment.seed(0)), 4 * BLOCK);
    let after = fs::read_to_string(&log).expect("the log");
    assert!(
        after.len() > before.len() && after.starts_with(&before),
        "{after}"
    );
}

#[test]
fn a_stopped_and_a_killed_training_go_on_to_the_steps_that_were_asked_for() {
    let mut experiment = Experiment::new("stops");
    let steps = (BLOCKS * BLOCK).to_string();
    let words = ["--steps", &steps, "--final-episodes", "0"];
    experiment.start(&words);
    until("two blocks are learnt", || experiment.blocks(0).len() >= 2);
    experiment.signal(Signal::TERM);
    let output = experiment.end();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(
        text(&output.stderr).contains("--resume continues"),
        "{output:?}"
    );
    let stopped = experiment.blocks(0);
    assert!(stopped.len() < BLOCKS as usize, "{stopped:?}");

    experiment.start(&["--resume", "--final-episodes", "0"]);
    until("another block is learnt", || {
        experiment.blocks(0).len() > stopped.len()
    });
    experiment.signal(Signal::KILL);
    let _ = experiment.end();
    until("the set ends with its training", || {
        experiment.pids("").is_empty()
    });

    let output = experiment.run(&["--resume", "--final-episodes", "0"]);
    assert!(output.status.success(), "{output:?}");
    assert_eq!(experiment.blocks(0), multiples(BLOCKS));
    let seed = experiment.seed(0);
    let mark = learner::journal::last_mark(&seed.join("learner/replay.bin"));
    let mark = mark.expect("a replay").expect("a record");
    let counted = mark.counts.driven();
    assert!(
        (BLOCKS * BLOCK - 2..=BLOCKS * BLOCK).contains(&counted),
        "no step too many: {counted}"
    );
}

#[test]
fn a_learner_killed_in_lockstep_costs_no_block_but_its_own() {
    let mut experiment = Experiment::new("kills");
    let steps = (BLOCKS * BLOCK).to_string();
    experiment.start(&["--steps", &steps, "--final-episodes", "0"]);
    let mut killed = Vec::new();
    for round in 1..=3 {
        until("blocks are learnt", || {
            experiment.blocks(0).len() >= 5 * round
        });
        let pids = experiment.pids("vlaps-learner");
        for pid in pids.iter().filter(|pid| !killed.contains(*pid)) {
            let pid = Pid::from_raw(*pid).expect("a process id");
            let _ = kill_process(pid, Signal::KILL);
        }
        killed.extend(pids);
    }
    let output = experiment.end();
    assert!(output.status.success(), "{output:?}");
    let blocks = experiment.blocks(0);
    assert_eq!(blocks.last(), Some(&(BLOCKS * BLOCK)), "{output:?}");
    assert!(
        blocks.iter().all(|steps| steps.is_multiple_of(BLOCK)),
        "{blocks:?}"
    );
    let lost = experiment.column(0, "learner/blocks.csv", "lost");
    let lost = lost.last().expect("a block");
    let is_told = text(&output.stdout).contains(&format!("seed 0: {lost} of {steps} steps"));
    assert!(lost == "0" || is_told, "{lost} lost: {output:?}");
}

#[test]
fn the_last_evaluation_can_be_stopped_and_gone_on_with() {
    let mut experiment = Experiment::new("final");
    let steps = BLOCK.to_string();
    experiment.start(&["--steps", &steps, "--final-episodes", "1000000"]);
    until("the evaluation of the only block is done", || {
        experiment.column(0, "evaluations.csv", "steps").len() == 1
            && experiment.pids("vlaps-world").is_empty()
    });
    // Now, or in a moment, a million episodes are on their way.
    experiment.signal(Signal::INT);
    let output = experiment.end();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    assert!(
        text(&output.stderr).contains("--resume continues"),
        "{output:?}"
    );
    assert!(!experiment.seed(0).join("final.json").exists());
    let output = experiment.run(&["--resume", "--final-episodes", "3"]);
    assert!(output.status.success(), "{output:?}");
    assert!(
        text(&output.stdout).contains("last policy, 1 seed x 3 episodes"),
        "{output:?}"
    );
}
