//! Tests that a learner that is stopped or killed continues from its state on disk.

use std::fs;
use std::path::Path;

use learner::session::Session;
use shm_config::config::{Algorithm, Config};
use shm_config::message::Step;
use tempfile::TempDir;

use crate::steps::{BLOCK, config, of_episode, step, vetoed};

const ALGORITHMS: [Algorithm; 5] = [
    Algorithm::Pvp,
    Algorithm::Ppl,
    Algorithm::Bc,
    Algorithm::HgDagger,
    Algorithm::Dagger,
];

/// Takes the steps of these ticks and learns at the end of each block; returns the last
/// policy.
fn drive(session: &mut Session, ticks: std::ops::Range<u64>) -> Vec<u8> {
    let mut policy = Vec::new();
    for tick in ticks {
        session.push(&match tick % 3 {
            0 => vetoed(step(tick)),
            _ => step(tick),
        });
        if session.is_due() {
            policy = session.learn(|| {}).expect("finite numbers").policy;
        }
    }
    policy
}

fn open(config: &Config, folder: &Path) -> Session {
    Session::open(config, folder).expect("a session")
}

#[test]
fn a_stopped_and_restarted_learner_learns_the_same() {
    for algorithm in ALGORITHMS {
        let config = config(algorithm);
        let [through, stopped] = [(), ()].map(|()| TempDir::new().expect("a folder"));
        // Both learners miss the step between the two halves.
        let halves = [0..BLOCK, BLOCK + 1..3 * BLOCK + 1];
        let mut session = open(&config, through.path());
        let first = drive(&mut session, halves[0].clone());
        let last = drive(&mut session, halves[1].clone());
        let counts = session.counts();
        session.finish();

        let mut session = open(&config, stopped.path());
        assert_eq!(
            drive(&mut session, halves[0].clone()),
            first,
            "{algorithm:?}"
        );
        session.finish();
        drop(session);
        let mut session = open(&config, stopped.path());
        assert_eq!(
            session.policy_file().expect("finite numbers"),
            first,
            "{algorithm:?}"
        );
        let again = drive(&mut session, halves[1].clone());
        assert!(
            !last.is_empty() && last != first,
            "{algorithm:?} learnt nothing"
        );
        assert!(
            again == last,
            "{algorithm:?} learnt something else after the stop"
        );
        assert_eq!(session.counts(), counts, "{algorithm:?}");
        session.finish();
        drop(session);
        for file in ["blocks.csv", "learner.bin"] {
            let [a, b] = [&through, &stopped].map(|folder| fs::read(folder.path().join(file)));
            let (a, b) = (a.expect("the file"), b.expect("the file"));
            assert!(a == b, "{algorithm:?}: {file} differs");
        }
    }
}

#[test]
fn a_learner_that_was_killed_goes_on_from_its_last_block() {
    for algorithm in [Algorithm::Pvp, Algorithm::HgDagger] {
        let config = config(algorithm);
        let folder = TempDir::new().expect("a folder");
        let mut session = open(&config, folder.path());
        let first = drive(&mut session, 0..BLOCK + 7);
        // A killed learner does not finish.
        drop(session);
        let mut session = open(&config, folder.path());
        assert_eq!(
            session.policy_file().expect("finite numbers"),
            first,
            "{algorithm:?}"
        );
        drive(&mut session, BLOCK + 9..3 * BLOCK);
        let counts = session.counts();
        assert_eq!(
            counts.steps + counts.lost,
            3 * BLOCK,
            "every step that was published is counted: {counts:?}"
        );
    }
}

#[test]
fn a_damaged_checkpoint_is_refused_with_its_name() {
    let config = config(Algorithm::Bc);
    let folder = TempDir::new().expect("a folder");
    drive(&mut open(&config, folder.path()), 0..BLOCK);
    let path = folder.path().join("learner.bin");
    let bytes = fs::read(&path).expect("a checkpoint");
    let mut cases: Vec<(String, Vec<u8>)> = [0, 1, 7, 8, 11, 12, bytes.len() / 2, bytes.len() - 1]
        .map(|length| (format!("cut to {length} bytes"), bytes[..length].to_vec()))
        .into();
    for offset in (0..bytes.len())
        .step_by(997)
        .chain([0, 8, 12, bytes.len() - 1])
    {
        let mut bad = bytes.clone();
        bad[offset] ^= 0x04;
        cases.push((format!("byte {offset} flipped"), bad));
    }
    for (what, bad) in cases {
        fs::write(&path, &bad).expect("a file");
        let error = Session::open(&config, folder.path()).err();
        let said = error
            .unwrap_or_else(|| panic!("{what}: accepted"))
            .to_string();
        let is_clear = said.contains("learner.bin") && said.contains("damaged");
        assert!(is_clear && said.contains("move it away"), "{what}: {said}");
        assert_eq!(
            fs::read(&path).expect("the file"),
            bad,
            "{what}: the file is unchanged"
        );
    }
    fs::write(&path, &bytes).expect("a file");
    open(&config, folder.path());
}

#[test]
fn a_replay_that_lacks_what_was_learnt_from_is_refused_and_unchanged() {
    let config = config(Algorithm::HgDagger);
    let folder = TempDir::new().expect("a folder");
    drive(&mut open(&config, folder.path()), 0..3 * BLOCK + 7);
    let path = folder.path().join("replay.bin");
    let bytes = fs::read(&path).expect("a replay");
    let mut flipped = bytes.clone();
    flipped[bytes.len() / 3] ^= 0x04;
    let half = bytes[..bytes.len() / 2].to_vec();
    for (what, bad) in [("half", half), ("empty", Vec::new()), ("flipped", flipped)] {
        fs::write(&path, &bad).expect("a file");
        let error = Session::open(&config, folder.path()).err();
        let said = error
            .unwrap_or_else(|| panic!("{what}: accepted"))
            .to_string();
        for words in ["replay.bin", "is damaged", "put the whole file back"] {
            assert!(said.contains(words), "{what}: {said}");
        }
        assert_eq!(
            fs::read(&path).expect("the file"),
            bad,
            "{what}: the file is unchanged"
        );
    }
    fs::remove_file(&path).expect("the file");
    Session::open(&config, folder.path())
        .err()
        .expect("a refusal");

    // A kill can damage only transitions that were not learnt from yet.
    fs::write(&path, &bytes[..bytes.len() - 1]).expect("a file");
    assert_eq!(open(&config, folder.path()).driven(), 3 * BLOCK + 6);
}

#[test]
fn a_folder_of_another_algorithm_is_refused_with_both_names() {
    let folder = TempDir::new().expect("a folder");
    drive(
        &mut open(&config(Algorithm::HgDagger), folder.path()),
        0..BLOCK,
    );
    let error = Session::open(&config(Algorithm::Pvp), folder.path()).err();
    let said = error.expect("a refusal").to_string();
    for word in ["hg-dagger", "pvp", "learner.bin", "move the folder away"] {
        assert!(said.contains(word), "{word}: {said}");
    }
}

#[test]
fn a_journal_of_another_kind_is_refused_with_its_name() {
    let folder = TempDir::new().expect("a folder");
    fs::write(folder.path().join("replay.bin"), b"something else").expect("a file");
    let error = Session::open(&config(Algorithm::Bc), folder.path()).err();
    let said = error.expect("a refusal").to_string();
    assert!(
        said.contains("replay.bin") && said.contains("move it away"),
        "{said}"
    );
}

/// A column of `blocks.csv`.
fn column(folder: &Path, name: &str) -> Vec<u64> {
    let text = fs::read_to_string(folder.join("blocks.csv")).expect("the blocks");
    let header = text.lines().next().expect("a header");
    let mut words = header.split(',');
    let at = words.position(|word| word == name).expect("the column");
    let field = |row: &str| row.split(',').nth(at).expect("a field").parse();
    let rows = text.lines().skip(1);
    rows.map(|row| field(row).expect("a number")).collect()
}

/// A step without a new observation: it completes only the transition before it.
fn blind(mut step: Step) -> Step {
    step.observation_age_ns = u64::MAX;
    step
}

#[test]
fn what_a_block_counted_stays_counted_after_a_kill() {
    let config = config(Algorithm::HgDagger);
    let folder = TempDir::new().expect("a folder");
    let mut session = open(&config, folder.path());
    drive(&mut session, 0..BLOCK / 2);
    session.push(&blind(step(BLOCK / 2)));
    // Steps are lost, and no transition is completed until the block has ended.
    session.push(&blind(step(2 * BLOCK - 1)));
    assert!(session.is_due());
    session.learn(|| {}).expect("finite numbers");
    let counts = session.counts();
    assert_eq!(counts.lost, 2 * BLOCK - BLOCK / 2 - 2);
    // A killed learner does not finish.
    drop(session);
    let mut session = open(&config, folder.path());
    assert_eq!(session.counts(), counts);
    assert!(!session.is_due(), "the block has been learnt from");
    // The controller was not killed, so its sequence numbers continue.
    drive(&mut session, 2 * BLOCK..3 * BLOCK);
    assert_eq!(session.driven(), 3 * BLOCK);
    assert_eq!(column(folder.path(), "lost"), [counts.lost; 2]);
    assert_eq!(column(folder.path(), "steps"), [2 * BLOCK, 3 * BLOCK]);
}

#[test]
fn blocks_end_on_the_grid_of_driven_steps_although_steps_were_missed() {
    let config = config(Algorithm::HgDagger);
    let folder = TempDir::new().expect("a folder");
    drive(&mut open(&config, folder.path()), 0..BLOCK + 7);
    // The learner is stopped at the end of the second and of the third block.
    let mut session = open(&config, folder.path());
    drive(&mut session, 3 * BLOCK + 5..5 * BLOCK);
    let column = |name| column(folder.path(), name);
    assert_eq!(column("steps"), [1, 3, 4, 5].map(|block| block * BLOCK));
    let lost = column("lost");
    assert!(lost[0] == 0 && lost[1] >= 2 * BLOCK - 3, "{lost:?}");
    assert_eq!(session.driven(), 5 * BLOCK);
}

#[test]
fn the_time_limit_ends_the_value_or_does_not() {
    // The built-in world's ticks are two of the run's.
    for (truncate_as_terminate, cut) in [(true, 0), (false, 2)] {
        let mut config = config(Algorithm::Pvp);
        config.learner.truncate_as_terminate = truncate_as_terminate;
        (config.world.horizon_ticks, config.run.rate_hz) = (3, 20.0);
        let folder = TempDir::new().expect("a folder");
        let mut session = open(&config, folder.path());
        // Episodes of 6, 5 and 6 ticks.
        for tick in 0..18 {
            let episode = [6, 11, 17].iter().filter(|end| tick >= **end).count();
            session.push(&of_episode(vetoed(step(tick)), episode as u32));
        }
        assert_eq!(session.counts().cut, cut);
    }
}

#[test]
fn a_block_whose_updates_were_cut_short_is_due_at_the_next_start() {
    let config = config(Algorithm::HgDagger);
    let folder = TempDir::new().expect("a folder");
    let mut session = open(&config, folder.path());
    for tick in 0..=BLOCK {
        session.push(&vetoed(step(tick)));
    }
    // The learner is killed before the updates.
    drop(session);
    let mut session = open(&config, folder.path());
    assert!(session.is_due());
    assert_eq!(session.learn(|| {}).expect("finite numbers").steps, BLOCK);
    assert!(!session.is_due());
}

#[test]
fn other_sizes_and_rates_are_refused_with_both_values() {
    let folder = TempDir::new().expect("a folder");
    drive(&mut open(&config(Algorithm::Pvp), folder.path()), 0..BLOCK);
    type Change = (&'static str, fn(&mut Config));
    let changes: [Change; 6] = [
        ("learner.hidden = 16, and 32", |config| {
            config.learner.hidden = 32
        }),
        ("learner.filters = 0, and 4", |config| {
            config.learner.filters = 4;
        }),
        ("learner.batch = 16, and 64", |config| {
            config.learner.batch = 64
        }),
        ("learner.rate = ", |config| config.learner.rate = 0.5),
        ("learner.target_noise = ", |config| {
            config.learner.target_noise = 0.0;
        }),
        ("learner.imitation_weight = 1, and 2", |config| {
            config.learner.imitation_weight = 2.0;
        }),
    ];
    for (words, change) in changes {
        let mut config = config(Algorithm::Pvp);
        change(&mut config);
        let error = Session::open(&config, folder.path()).err();
        let said = error.expect(words).to_string();
        assert!(
            said.contains(words) && said.contains("learner.bin"),
            "{said}"
        );
    }
    open(&config(Algorithm::Pvp), folder.path());
}

#[test]
fn another_weight_of_the_pedal_is_refused_but_for_pvp() {
    for (algorithm, is_refused) in [(Algorithm::Bc, true), (Algorithm::Pvp, false)] {
        let folder = TempDir::new().expect("a folder");
        drive(&mut open(&config(algorithm), folder.path()), 0..BLOCK);
        let mut other = config(algorithm);
        other.learner.excess_pedal = 2.0;
        let error = Session::open(&other, folder.path()).err();
        let said = error.map(|error| error.to_string());
        match is_refused {
            true => assert!(
                said.as_ref()
                    .is_some_and(|said| said.contains("learner.excess_pedal = 1, and 2")),
                "{said:?}"
            ),
            false => assert_eq!(said, None),
        }
    }
}

#[test]
fn temporary_files_of_a_killed_learner_are_removed() {
    let folder = TempDir::new().expect("a folder");
    let config = config(Algorithm::Bc);
    drive(&mut open(&config, folder.path()), 0..BLOCK);
    let torn =
        ["learner.bin.4711-0", "policies/000200.onnx.4711-1"].map(|name| folder.path().join(name));
    for path in &torn {
        fs::write(path, b"half").expect("a file");
    }
    open(&config, folder.path());
    for path in &torn {
        assert!(!path.exists(), "{}", path.display());
    }
    assert!(folder.path().join("learner.bin").exists());
}
