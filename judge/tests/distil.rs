//! Distillation: the same file for the same seed, a net that finds the rule behind its
//! teacher's answers also when many are wrong, and records that cannot teach.

#[path = "../../gate/tests/records/mod.rs"]
mod records;

use std::path::{Path, PathBuf};

use gate::distilled::encode;
use gate::presentation::Party;
use gate::record::store::Store;
use gate::record::{NetOpinion, Proposed, Record};
use judge::distil::samples::Sample;
use judge::distil::{Figures, Learn, Samples, Schedule, Split, distil};
use records::record;
use shm_config::draw::Draw;
use shm_config::message::{Observation, Preference};
use shm_config::seen::Seen;

/// A straight road with a wall ahead on one side. The proposal that steers towards it
/// ends in an accident, and the teacher knows that.
fn question(draw: &mut Draw, (episode, tick): (u32, u64)) -> Record {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.ranges_m.fill(50.0);
    (observation.road.left_m, observation.road.right_m) = (6.0, 6.0);
    observation.ego.speed_mps = draw.within(4.0, 9.0);
    observation.checkpoints[0].x_body_m = 40.0;
    let is_left = draw.one_in(2);
    let range_m = draw.within(6.0, 12.0) as f32;
    let beams = if is_left { 6..24 } else { 216..234 };
    observation.ranges_m[beams].fill(range_m);
    observation.header.episode = episode;
    let away = if is_left { -1.0 } else { 1.0 };
    let safer = match draw.one_in(2) {
        true => Party::Expert,
        false => Party::Policy,
    };
    let mut towards = |towards: f64| Proposed {
        steer: towards * draw.within(0.05, 0.4),
        pedal: draw.within(-0.2, 0.6),
        clearance_m: 3.0,
        safe_s: 3.0,
        vetoed: false,
    };
    let [good, bad] = [towards(away), towards(-away)];
    let (expert, policy) = match safer {
        Party::Expert => (good, bad),
        Party::Policy => (bad, good),
    };
    Record {
        tick,
        episode,
        taken_ns: tick * 100_000_000,
        judge: "rules".into(),
        preset: String::new(),
        model: String::new(),
        observation: Some(Box::new(Seen::new(&observation))),
        expert: Some(expert),
        policy: Some(policy),
        ..record(
            Vec::new(),
            Some(match safer {
                Party::Expert => Preference::Expert,
                Party::Policy => Preference::Policy,
            }),
            safer,
        )
    }
}

/// A folder of records: 20 questions in each of these episodes.
fn recorded(folder: &Path, seed: u64, episodes: u32) -> PathBuf {
    let mut store = Store::open(folder, 1 << 26).expect("opens");
    let mut draw = Draw::new(seed);
    for episode in 0..episodes {
        for tick in 0..20 {
            let question = store.begin(question(&mut draw, (episode, tick * 20)), &[]);
            store.complete(question);
        }
    }
    folder.into()
}

fn schedule(seed: u64) -> Schedule {
    Schedule {
        learn: Learn::Answers,
        members: 3,
        epochs: 12,
        seed,
    }
}

fn trained(samples: &Samples, seed: u64) -> gate::distilled::DistilledNet {
    let split = Split::of(&samples.samples, seed).expect("enough episodes");
    distil(samples, &split, (&schedule(seed), 0.15), "0123abcd", |_| ()).expect("trains")
}

#[test]
fn the_same_seed_gives_the_same_file_bit_by_bit() {
    let folder = tempfile::tempdir().expect("a folder");
    let runs = [recorded(folder.path(), 1, 20)];
    let file = |seed| encode(&trained(&Samples::read(&runs).expect("reads"), seed));
    assert_eq!(file(4), file(4));
    assert_ne!(file(4), file(5));
}

#[test]
fn a_net_is_right_more_often_than_a_teacher_that_is_often_wrong() {
    let (learned, tested) = (tempfile::tempdir(), tempfile::tempdir());
    let learned = recorded(learned.as_ref().expect("a folder").path(), 2, 60);
    let tested = recorded(tested.as_ref().expect("a folder").path(), 3, 20);
    let mut samples = Samples::read(&[learned]).expect("reads");
    let mut tests = Samples::read(&[tested]).expect("reads");
    samples.spoil(0.3, 7);
    tests.spoil(0.3, 8);
    let mut net = trained(&samples, 0);
    let figures = Figures::of(&mut net, &tests.samples.iter().collect::<Vec<&Sample>>());
    let [net, teacher] = [figures.net_beside, figures.teacher].map(|share| share.mean());
    assert!(
        (0.6..0.8).contains(&figures.teacher_alone.mean()),
        "{figures:?}"
    );
    assert!(net > 0.9 && net > teacher, "{net} {teacher}");
    let passed_on = figures.passed_on.mean();
    assert!((0.02..0.2).contains(&passed_on), "{passed_on}");
}

#[test]
fn all_questions_of_a_map_are_in_one_part() {
    let folder = tempfile::tempdir().expect("a folder");
    let runs = [recorded(folder.path(), 1, 30)];
    let samples = Samples::read(&runs).expect("reads").samples;
    let split = Split::of(&samples, 9).expect("enough episodes");
    let groups = |indices: &[usize]| -> Vec<u64> {
        indices.iter().map(|index| samples[*index].group).collect()
    };
    let [learn, stop, calibrate] =
        [&split.learn, &split.stop, &split.calibrate].map(|part| groups(part));
    assert_eq!([stop.len(), calibrate.len(), learn.len()], [60, 120, 420]);
    for group in &learn {
        assert!(!stop.contains(group) && !calibrate.contains(group));
    }
    assert!(stop.iter().all(|group| !calibrate.contains(group)));
}

#[test]
fn records_that_cannot_teach_are_named() {
    let reason = |change: fn(&mut Record)| {
        let folder = tempfile::tempdir().expect("a folder");
        let mut store = Store::open(folder.path(), 1 << 24).expect("opens");
        let mut draw = Draw::new(1);
        for tick in 0..2 {
            let mut question = question(&mut draw, (0, tick));
            if tick == 1 {
                change(&mut question);
            }
            let question = store.begin(question, &[]);
            store.complete(question);
        }
        let read = Samples::read(&[folder.path().into()]);
        let samples = read.map(|samples| Split::of(&samples.samples, 0).map(|_| ()));
        format!(
            "{:#}",
            samples.and_then(|split| split).expect_err("refused")
        )
    };
    let old = reason(|record| record.observation = None);
    assert!(
        old.contains("question 2") && old.contains("record the run again"),
        "{old}"
    );
    let mixed = reason(|record| record.judge = "human".into());
    assert!(
        mixed.contains("human") && mixed.contains("one judge at a time"),
        "{mixed}"
    );
    let few = reason(|_| ());
    assert!(few.contains("too few"), "{few}");
    let nothing = Samples::read(&[PathBuf::from("no/such/run")]).expect_err("refused");
    assert!(
        nothing.to_string().contains("no record of a judge here"),
        "{nothing}"
    );
}

#[test]
fn a_nets_own_answers_teach_nothing() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = Store::open(folder.path(), 1 << 24).expect("opens");
    let mut draw = Draw::new(1);
    for audit in [None, Some("expert"), Some("failed")] {
        let mut own = question(&mut draw, (0, 0));
        own.judge = "distilled".into();
        own.net = Some(NetOpinion {
            expert: Some(0.9),
            policy: Some(0.05),
            similar: Some(0.05),
            passed_on: None,
            audit: audit.map(String::from),
        });
        let question = store.begin(own, &[]);
        store.complete(question);
    }
    drop(store);
    let samples = Samples::read(&[folder.path().into()])
        .expect("reads")
        .samples;
    let taught: Vec<_> = samples
        .iter()
        .map(|sample| sample.answer.is_some())
        .collect();
    assert_eq!(taught, [false, true, false]);
}
