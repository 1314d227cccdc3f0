//! A learner in a real process set: its results repeat, and its death does not disturb
//! the run.

use std::fs;
use std::path::PathBuf;

use learner::assembler::Counts;
use learner::journal::{Journal, Mark, Recovered};
use learner::replay::Buffer;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rustix::process::Signal;
use vlaps_tests::{Set, until};

/// The journal's first bytes.
const MAGIC_BYTES: u64 = 8;
/// Approximate size of a record in the journal, bytes.
const RECORD_BYTES: u64 = 2200;

fn folder(set: &Set) -> PathBuf {
    let run = set.folder().join("runs").join(set.name().to_string());
    run.join("learner")
}

/// The options `--set` for these settings.
fn overrides<'a>(settings: &[&'a str]) -> Vec<&'a str> {
    settings
        .iter()
        .flat_map(|setting| ["--set", setting])
        .collect()
}

fn journal_bytes(set: &Set) -> u64 {
    fs::metadata(folder(set).join("replay.bin")).map_or(0, |file| file.len())
}

/// The journal after the run, and the counts in its last record.
fn recovered(set: &Set) -> (Recovered, Mark) {
    let path = folder(set).join("replay.bin");
    let found = Journal::open(&path, 50_000, 0).expect("a journal");
    let mark = found.mark.expect("a record at least");
    (found, mark)
}

/// Names and contents of the policies.
fn policies(set: &Set) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(folder(set).join("policies")).expect("policies");
    let mut policies: Vec<(String, Vec<u8>)> = entries
        .map(|entry| {
            let path = entry.expect("an entry").path();
            let name = path.file_name().expect("a name").display().to_string();
            (name, fs::read(&path).expect("a policy"))
        })
        .collect();
    policies.sort();
    policies
}

/// Every published step was read or is counted as lost.
fn assert_accounts(
    Mark {
        counts, sequence, ..
    }: &Mark,
) {
    assert_eq!(counts.steps + counts.lost, *sequence, "{counts:?}");
}

#[test]
fn in_lockstep_the_same_seed_teaches_the_same_policies() {
    let drive = |label: &str| {
        let set = Set::new(label);
        let settings = overrides(&[
            "learner.enabled=true",
            "learner.algorithm=dagger",
            "learner.block_steps=50",
            "learner.updates=20",
            "learner.batch=32",
            "learner.hidden=32",
            "learner.imagined_scenes=1",
            // Any weights pass, because the test does not depend on how they drive.
            "policy.veto_rate_max=1.0",
            "policy.shadow_ticks=3",
        ]);
        let words = [
            "--lockstep",
            "--seed",
            "3",
            "--duration",
            "20",
            "--gate",
            "policy",
        ];
        let output = set.run(&[&words[..], &settings].concat());
        assert!(output.status.success(), "{output:?}\n{}", set.logs());
        let (_, mark) = recovered(&set);
        assert_accounts(&mark);
        assert_eq!(mark.counts.lost, 0, "seed 3: {}", set.logs());
        (set.json(), policies(&set), mark.counts)
    };
    // Both run at the same time: the result must not depend on the machine's load.
    let runs = ["learna", "learnb"].map(|label| std::thread::spawn(move || drive(label)));
    let [a, b] = runs.map(|run| run.join().expect("a run"));
    assert_eq!(a.0["command_digest"], b.0["command_digest"], "seed 3");
    assert_eq!(a.0["reasons"], b.0["reasons"], "seed 3");
    assert_eq!(a.2, b.2, "seed 3");
    assert!(a.1.len() >= 3, "a policy for each block: {}", a.1.len());
    assert!(a.1 == b.1, "seed 3: the policies differ");
    assert!(
        a.0["share"]["policy"].as_f64() > Some(0.01),
        "it drove: {}",
        a.0
    );
}

#[test]
fn a_learner_that_is_killed_again_and_again_costs_the_run_nothing() {
    const SEED: u64 = 7;
    const KILLS: u64 = 20;
    let mut set = Set::new("learnkill");
    let settings = overrides(&[
        "learner.enabled=true",
        "learner.algorithm=hg-dagger",
        "learner.block_steps=100",
        "learner.updates=10",
        "learner.batch=32",
        "learner.hidden=32",
        "supervisor.restarts_max=1000",
        "supervisor.backoff_max_ms=20",
        // A busy machine may delay any process.
        "limits.command_age_ms=2000",
    ]);
    let words = [
        "--seed",
        "3",
        "--no-realtime",
        "--rate",
        "100",
        "--gate",
        "expert",
    ];
    set.start(&[&words[..], &settings].concat());
    let mut random = Xoshiro256PlusPlus::seed_from_u64(SEED);
    let mut killed = Vec::new();
    for round in 0..KILLS {
        until("the learner lives", || {
            let pids = set.pids("vlaps-learner");
            pids.len() == 1 && !killed.contains(&pids[0])
        });
        // Killed at a random instant between its start and about one block later.
        let more = random.random_range(0..60) * RECORD_BYTES;
        let from = journal_bytes(&set);
        let grown = || journal_bytes(&set) >= from + more;
        until(
            &format!("{more} bytes more, seed {SEED}, round {round}"),
            grown,
        );
        killed.extend(set.pids("vlaps-learner"));
        assert_eq!(set.signal_program("vlaps-learner", Signal::KILL), 1);
    }
    let from = journal_bytes(&set);
    until("the last learner learns", || {
        journal_bytes(&set) > from + 20 * RECORD_BYTES
    });
    set.signal(Signal::INT);
    assert_eq!(set.wait(), Some(0), "seed {SEED}: {}", set.logs());

    let json = set.json();
    assert_eq!(json["processes"]["learner"]["restarts"], KILLS, "{json}");
    assert_eq!(json["restarts"], KILLS, "no other process died: {json}");
    assert_eq!(json["braked"], 0, "there always was a command: {json}");
    let number = |key: &str| json[key].as_f64().expect(key);
    let instants = (number("elapsed_s") / number("period_s")).round();
    assert_eq!(instants, number("ticks") + number("skipped"), "{json}");

    let (found, mark) = recovered(&set);
    assert_eq!(found.torn_bytes, 0, "the last one ended in order");
    assert_accounts(&mark);
    let counts: Counts = mark.counts;
    let held: u64 = Buffer::ALL
        .iter()
        .map(|&buffer| found.replay.len(buffer) as u64)
        .sum();
    assert_eq!(held, counts.transitions(), "seed {SEED}: {counts:?}");
    let published = json["processes"]["controller"]["ticks"].as_u64();
    assert!(
        Some(mark.sequence) <= published,
        "{counts:?}, {published:?} published"
    );
    assert!(counts.lost > 0, "it was never away: {counts:?}");
}

#[test]
fn in_lockstep_a_run_outlives_the_learner_it_waits_for() {
    const BLOCK: u64 = 50;
    let mut set = Set::new("learnwait");
    let settings = overrides(&[
        "learner.enabled=true",
        "learner.algorithm=hg-dagger",
        "learner.block_steps=50",
        // The controller waits this many seconds at the end of each block.
        "learner.updates=600",
        "learner.batch=256",
        "supervisor.restarts_max=10",
    ]);
    let words = [
        "--lockstep",
        "--seed",
        "3",
        "--duration",
        "16",
        "--gate",
        "expert",
    ];
    set.start(&[&words[..], &settings].concat());
    // The whole block is on disk, except the step whose successor is missing.
    until("the block is full", || {
        journal_bytes(&set) > MAGIC_BYTES + (BLOCK - 3) * RECORD_BYTES
    });
    let (mut before, mut still) = (0, 0);
    until("nothing moves but the learner's updates", || {
        let now = journal_bytes(&set);
        still = if now == before { still + 1 } else { 0 };
        before = now;
        still == 5
    });
    assert_eq!(set.signal_program("vlaps-learner", Signal::KILL), 1);
    assert_eq!(set.wait(), Some(0), "{}", set.logs());
    let json = set.json();
    assert_eq!(json["processes"]["learner"]["restarts"], 1, "{json}");
    assert_eq!(json["restarts"], 1, "{json}");
    assert_eq!(json["skipped"], 0, "{json}");
    assert_eq!(json["braked"], 0, "{json}");
    assert_eq!(json["ticks"], 160, "{json}");
    let (_, mark) = recovered(&set);
    assert_accounts(&mark);
    assert!(!policies(&set).is_empty(), "the successor learnt");
}

#[test]
fn a_run_that_goes_on_waits_for_the_updates_that_its_learner_was_killed_in() {
    let set = Set::new("learndue");
    let settings = overrides(&[
        "learner.enabled=true",
        "learner.algorithm=dagger",
        "learner.block_steps=50",
        // In this many seconds the whole run would be driven.
        "learner.updates=600",
        "learner.batch=256",
        "learner.imagined_scenes=1",
        "policy.veto_rate_max=1.0",
        "policy.jump_max=2.0",
        "policy.shadow_ticks=0",
    ]);
    let words = [
        "--lockstep",
        "--seed",
        "3",
        "--duration",
        "6",
        "--gate",
        "policy",
    ];
    let drive = || {
        let output = set.run(&[&words[..], &settings].concat());
        assert!(output.status.success(), "{output:?}\n{}", set.logs());
        set.json()["reasons"].clone()
    };
    let before = drive().to_string();
    assert!(
        before.contains("unloaded"),
        "a block has no policy yet: {before}"
    );
    // As if the learner had been killed before it first saved its networks.
    fs::remove_file(folder(&set).join("learner.bin")).expect("networks");
    let after = drive().to_string();
    assert!(
        !after.contains("unloaded"),
        "driven without a policy: {after}"
    );
}

#[test]
fn the_controller_waits_for_a_block_of_updates_as_long_as_the_limits_say() {
    let unloaded = |wait: &str| {
        let set = Set::new("learnlimit");
        let settings = overrides(&[
            "learner.enabled=true",
            "learner.algorithm=dagger",
            "learner.block_steps=20",
            // Imagined scenes are learnt from at once, driven ones when their label has come.
            "learner.imagined_scenes=1",
            // They take ten times as long as the rest of the run.
            "learner.updates=500",
            "learner.batch=256",
            "policy.veto_rate_max=1.0",
            "policy.jump_max=2.0",
            "policy.shadow_ticks=0",
            wait,
        ]);
        let words = ["--lockstep", "--seed", "3", "--duration", "4"];
        let output = set.run(&[&words[..], &["--gate", "policy"], &settings].concat());
        assert!(output.status.success(), "{output:?}\n{}", set.logs());
        let json = set.json();
        assert_eq!(json["ticks"], 40, "{json}");
        json["reasons"]["expert"]["unloaded"].as_u64().unwrap_or(0)
    };
    let waited = unloaded("limits.learner_wait_s=120");
    assert_eq!(waited, 20, "the ticks of the first block");
    assert_eq!(unloaded("limits.learner_wait_s=0.05"), 40);
}
