//! A policy trained anew on the replay of a session.

use std::fs;
use std::path::Path;

use learner::algorithm::Losses;
use learner::relearn::Relearning;
use learner::session::Session;
use policy::{Net, decode};
use shm_config::config::{Algorithm, Config};
use tempfile::TempDir;

use crate::steps::{BLOCK, config, step, vetoed};

/// Two blocks, and the step after them.
const STEPS: u64 = 2 * BLOCK + 1;

/// A session of some blocks, every third step vetoed if so asked.
fn session(algorithm: Algorithm, is_vetoed: bool) -> TempDir {
    let folder = TempDir::new().expect("a folder");
    let mut session = Session::open(&config(algorithm), folder.path()).expect("a session");
    for tick in 0..STEPS {
        session.push(&match is_vetoed && tick % 3 == 0 {
            true => vetoed(step(tick)),
            false => step(tick),
        });
        if session.is_due() {
            session.learn(|| {}).expect("finite numbers");
        }
    }
    session.finish();
    folder
}

fn open(config: &Config, folder: &Path) -> Relearning {
    Relearning::open(config, &[folder.into()], "0123abcd".into()).expect("a replay")
}

/// The policy after so many updates, and the loss of the last one.
fn relearn(config: &Config, folder: &Path, updates: u32) -> (Vec<u8>, f32) {
    let mut relearning = open(config, folder);
    let mut losses = Losses::default();
    for _ in 0..updates {
        losses = relearning.update();
    }
    (
        relearning.policy_file().expect("finite numbers"),
        losses.actor,
    )
}

#[test]
fn every_algorithm_learns_anew_the_same_each_time_and_leaves_the_session_as_it_was() {
    for algorithm in [
        Algorithm::Pvp,
        Algorithm::Ppl,
        Algorithm::HgDagger,
        Algorithm::Dagger,
    ] {
        let folder = session(algorithm, true);
        let config = config(algorithm);
        let files = ["replay.bin", "learner.bin", "blocks.csv"];
        let read = || files.map(|file| fs::read(folder.path().join(file)).expect("the file"));
        let before = read();
        let (first, _) = relearn(&config, folder.path(), 50);
        let (again, _) = relearn(&config, folder.path(), 50);
        let (fewer, _) = relearn(&config, folder.path(), 1);
        assert!(first == again, "{algorithm:?}: another policy");
        assert!(first != fewer, "{algorithm:?} learnt nothing");
        assert!(before == read(), "{algorithm:?}: the session is changed");
        let file = decode(&first).expect("a policy file");
        let provenance = file.provenance.expect("ours");
        assert_eq!(provenance.algorithm, algorithm.word());
        assert_eq!(
            (provenance.steps, &provenance.commit[..]),
            (STEPS, "0123abcd")
        );
        assert!(matches!(file.net, Net::Mlp { .. }) && !file.probes.is_empty());
    }
}

#[test]
fn another_algorithm_and_size_may_learn_from_a_session() {
    let folder = session(Algorithm::Ppl, true);
    let of_ppl = open(&config(Algorithm::Ppl), folder.path());
    let mut all = config(Algorithm::Dagger);
    all.learner.hidden = 24;
    let of_all = open(&all, folder.path());
    assert!(
        of_all.transitions() > of_ppl.transitions(),
        "the policy drove, too"
    );
    let (_, first) = relearn(&all, folder.path(), 1);
    let (_, last) = relearn(&all, folder.path(), 3000);
    assert!(last < 0.5 * first, "loss {first}, then {last}");
}

#[test]
fn several_sessions_teach_together_as_much_as_there_is_room_for() {
    let sessions = [
        session(Algorithm::Ppl, true),
        session(Algorithm::Dagger, true),
    ];
    let folders = [&sessions[0], &sessions[1]].map(|folder| folder.path().to_path_buf());
    let mut config = config(Algorithm::Dagger);
    config.learner.capacity = 10_000;
    let apart = [0, 1].map(|k| open(&config, &folders[k]).transitions());
    let together = |config: &Config| Relearning::open(config, &folders, String::new());
    let both = together(&config).expect("two replays");
    assert_eq!(both.transitions(), apart[0] + apart[1]);
    let file = decode(&both.policy_file().expect("finite")).expect("a policy file");
    assert_eq!(file.provenance.expect("ours").steps, 2 * STEPS);
    assert_eq!(both.left_out(), 0);
    config.learner.capacity = 5;
    let newest = together(&config).expect("two replays");
    assert_eq!(newest.transitions(), 3 * 5);
    let read = newest.transitions() as u64 + newest.left_out();
    assert_eq!(read, both.transitions() as u64);
}

#[test]
fn a_replay_that_is_missing_damaged_or_has_nothing_to_learn_from_is_refused_by_name() {
    let refusal = |config: &Config, folder: &Path| {
        let error = Relearning::open(config, &[folder.into()], String::new()).err();
        let said = error.expect("refused").to_string();
        assert!(said.contains("replay.bin"), "{said}");
        said
    };
    let empty = TempDir::new().expect("a folder");
    refusal(&config(Algorithm::Ppl), empty.path());
    fs::write(empty.path().join("replay.bin"), b"something else").expect("a file");
    refusal(&config(Algorithm::Ppl), empty.path());
    assert_eq!(
        fs::read(empty.path().join("replay.bin")).expect("the file"),
        b"something else"
    );

    let folder = session(Algorithm::Dagger, true);
    let path = folder.path().join("replay.bin");
    let mut bytes = fs::read(&path).expect("the file");
    let middle = bytes.len() / 2;
    bytes[middle..middle + 8].fill(0xff);
    fs::write(&path, &bytes).expect("a file");
    let said = refusal(&config(Algorithm::Dagger), folder.path());
    assert!(said.contains("is damaged"), "{said}");

    let folder = session(Algorithm::HgDagger, false);
    let said = refusal(&config(Algorithm::HgDagger), folder.path());
    assert!(
        said.contains("nothing that hg-dagger learns from"),
        "{said}"
    );
    open(&config(Algorithm::Dagger), folder.path());
}

#[test]
fn a_record_that_is_being_written_is_left_alone() {
    let folder = session(Algorithm::Dagger, true);
    let config = config(Algorithm::Dagger);
    let path = folder.path().join("replay.bin");
    let mut bytes = fs::read(&path).expect("the file");
    let whole = open(&config, folder.path()).transitions();
    bytes.truncate(bytes.len() - 100);
    fs::write(&path, &bytes).expect("a file");
    assert_eq!(open(&config, folder.path()).transitions(), whole - 1);
    assert_eq!(fs::read(&path).expect("the file").len(), bytes.len());
}

#[test]
fn with_no_updates_the_named_policy_drives_and_its_steps_can_be_learnt_anew() {
    let before = session(Algorithm::Dagger, false);
    let mut config = config(Algorithm::Dagger);
    let (policy, _) = relearn(&config, before.path(), 5);
    let file = before.path().join("given.onnx");
    fs::write(&file, &policy).expect("a file");
    config.policy.file = file.display().to_string();
    config.learner.updates = 0;
    let folder = TempDir::new().expect("a folder");
    let mut session = Session::open(&config, folder.path()).expect("a session");
    assert!(session.driving_policy().expect("the file").as_ref() == Some(&policy));
    for tick in 0..STEPS {
        session.push(&step(tick));
        if session.is_due() {
            assert!(session.learn(|| {}).expect("the file").policy == policy);
        }
    }
    session.finish();
    assert_eq!(session.learnt(), 2 * BLOCK);
    assert!(open(&config, folder.path()).transitions() as u64 >= STEPS - 1);

    // The session goes on with the same policy only.
    let other = before.path().join("other.onnx");
    fs::write(&other, relearn(&config, before.path(), 6).0).expect("a file");
    config.policy.file = other.display().to_string();
    let error = Session::open(&config, folder.path()).err();
    let told = error.expect("another policy").to_string();
    assert!(told.contains("is another policy than"), "{told}");
    config.policy.file = file.display().to_string();
    Session::open(&config, folder.path()).expect("the session");

    let folder = TempDir::new().expect("a folder");
    let cut = before.path().join("cut.onnx");
    fs::write(&cut, &policy[..policy.len() / 2]).expect("a file");
    let cut = cut.display().to_string();
    // The last one would never end.
    for file in ["nowhere.onnx", &cut, "/dev/zero"] {
        config.policy.file = file.into();
        let error = Session::open(&config, folder.path()).err();
        let told = error.expect(file).to_string();
        assert!(told.contains(file), "{told}");
    }
}

#[test]
fn a_policy_that_is_told_more_than_is_recorded_does_not_drive() {
    let before = session(Algorithm::Dagger, false);
    let mut config = config(Algorithm::Dagger);
    config.learner.motion = true;
    let file = before.path().join("told.onnx");
    fs::write(&file, relearn(&config, before.path(), 1).0).expect("a file");
    config.policy.file = file.display().to_string();
    config.learner.updates = 0;
    let folder = TempDir::new().expect("a folder");
    Session::open(&config, folder.path()).expect("a session");
    config.learner.motion = false;
    let folder = TempDir::new().expect("a folder");
    let error = Session::open(&config, folder.path()).err();
    let told = error.expect("told more").to_string();
    assert!(told.contains("learner.motion=true"), "{told}");
}

#[test]
fn a_network_whose_policy_file_fits_into_no_message_is_refused_before_it_learns() {
    let folder = session(Algorithm::Dagger, false);
    let mut large = config(Algorithm::Dagger);
    (large.learner.hidden, large.learner.filters) = (1024, 64);
    let relearning = Relearning::open(&large, &[folder.path().into()], String::new()).err();
    let empty = TempDir::new().expect("a folder");
    let session = Session::open(&large, empty.path()).err();
    for error in [relearning, session] {
        let said = error.expect("too large").to_string();
        assert!(said.contains("the limit is 8388608"), "{said}");
    }
    large.learner.filters = 16;
    Session::open(&large, empty.path()).expect("a session");
}
