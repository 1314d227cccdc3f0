//! An actor drives as the process set does: the same transitions, and the same drivers for the
//! same reasons.

use std::collections::BTreeMap;
use std::fs;
use std::ops::ControlFlow;
use std::path::Path;
use std::process::{Command, Stdio};

use lab::actors::drive::Episodes;
use lab::actors::message::EpisodeKey;
use lab::replay::rehearsal::policy_file;
use learner::journal::{Journal, Recovered};
use learner::replay::{Buffer, Transition};
use shm_config::message::Reason;
use supervisor::subcommand::settings;
use tempfile::TempDir;
use vlaps_tests::{Set, programs};

/// Steps of the only block: more than an episode.
const BLOCK: usize = 100;
/// Steps of an episode, in which the car does not arrive.
const EPISODE: usize = 60;

/// The transitions of a training of one block, in which the expert drives.
fn transitions(actors: Option<&str>) -> Vec<Transition> {
    let place = TempDir::new().expect("a folder");
    let words = format!(
        "train --algorithm dagger --expert informed --eval-episodes 1 --final-episodes 0 --out out \
         --steps {BLOCK} --set learner.block_steps={BLOCK} --set learner.updates=2 \
         --set learner.batch=16 --set learner.hidden=16 --set learner.imagined_scenes=0 \
         --set world.horizon_ticks={EPISODE}"
    );
    let output = Command::new(programs().join("vlaps-lab"))
        .args(words.split_whitespace())
        .args(actors.map(|actors| format!("--actors={actors}")))
        .current_dir(place.path())
        .stdin(Stdio::null())
        .output()
        .expect("it starts");
    assert!(output.status.success(), "{output:?}");
    read(&place.path().join("out/seed-0/learner/replay.bin"))
}

fn read(journal: &Path) -> Vec<Transition> {
    let Recovered { replay, .. } = Journal::open(journal, 10_000, 0).expect("a journal");
    let buffers = Buffer::ALL.into_iter();
    buffers
        .flat_map(|buffer| replay.iter(buffer).cloned())
        .collect()
}

#[test]
fn an_actor_makes_the_transitions_of_a_process_set() {
    let (set, actors) = (transitions(None), transitions(Some("2")));
    assert_eq!(actors.len(), BLOCK);
    assert!(set.len() > EPISODE, "{}", set.len());
    for (index, (ours, theirs)) in actors.iter().zip(&set).take(EPISODE).enumerate() {
        assert!(
            ours == theirs,
            "transition {index}: {ours:?} and {theirs:?}"
        );
    }
    // The second scenario is the same. Its plans are not: the tick decides which random
    // numbers the planner draws, and an actor counts it from each episode's beginning.
    assert_eq!(actors[EPISODE].state, set[EPISODE].state);
}

#[test]
fn a_policy_drives_in_an_actor_when_it_drives_in_a_process_set() {
    let set = Set::new("actor");
    let policy = policy_file(3).expect("a policy");
    fs::write(set.folder().join("policy.onnx"), &policy.bytes).expect("written");
    let overrides = [
        "run.seed=1004",
        "gate.mode=rules",
        "gate.period_s=1",
        "gate.dwell_s=0",
        "policy.shadow_ticks=0",
        "policy.watch_ticks=0",
        "planner.method=informed",
    ]
    .map(String::from);
    let mut words = vec!["--lockstep", "--episodes", "1", "--policy", "policy.onnx"];
    for text in &overrides {
        words.extend(["--set", text]);
    }
    let output = set.run(&words);
    assert!(output.status.success(), "{output:?}\n{}", set.logs());
    let json = set.json();

    let config = settings::config([None, None], &overrides).expect("a configuration");
    let episodes = Episodes::new(&config).expect("episodes");
    let mut reasons: BTreeMap<&str, BTreeMap<&str, u64>> = BTreeMap::new();
    let key = EpisodeKey {
        block: 0,
        episode: 0,
    };
    let built = episodes.policy(1, &policy.bytes).expect("a policy");
    let ticks = episodes.drive(key, 100_000, Some(built), |step| {
        let reason = step.reason().map_or("unknown", Reason::word);
        let of_driver = reasons.entry(step.driver().word()).or_default();
        *of_driver.entry(reason).or_default() += 1;
        ControlFlow::Continue(())
    });
    assert_eq!(json["ticks"], ticks.expect("driven"), "{json}");
    let shown = serde_json::to_value(&reasons).expect("JSON");
    let mut theirs = json["reasons"].clone();
    // The set lists drivers and reasons that did not occur, too.
    for of_driver in theirs.as_object_mut().expect("drivers").values_mut() {
        let of_driver = of_driver.as_object_mut().expect("reasons");
        of_driver.retain(|_, count| *count != 0);
    }
    theirs
        .as_object_mut()
        .expect("drivers")
        .retain(|_, of_driver| {
            of_driver
                .as_object()
                .is_some_and(|reasons| !reasons.is_empty())
        });
    assert_eq!(shown, theirs);
    assert!(reasons["policy"].values().sum::<u64>() > 0, "{reasons:?}");
}
