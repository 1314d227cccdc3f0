//! Distillation: the same file for the same seed, a net that finds the rule behind its
//! teacher's answers also when many are wrong, and records that cannot teach.

use std::path::{Path, PathBuf};

use gate::distilled::encode;
use gate::presentation::{Party, Reply};
use gate::record::store::Store;
use gate::record::{Asking, NetOpinion, Proposed, Record, Unsure};
use judge::distil::samples::Sample;
use judge::distil::{Figures, Group, Learn, Samples, Schedule, Split, distil};
use shm_config::config::Run;
use shm_config::draw::Draw;
use shm_config::message::{Observation, Preference};
use shm_config::seen::Seen;

use crate::records::{SHOWING, asking, record};

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
    let groups = |indices: &[usize]| -> Vec<Group> {
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

/// A run with these lines in section `run` of its configuration, and 20 questions in each of
/// these episodes in this folder.
fn configured(folder: &Path, (records, run): (&str, &str), episodes: u32) -> PathBuf {
    std::fs::write(folder.join("config.toml"), format!("[run]\n{run}\n")).expect("written");
    recorded(&folder.join(records), 1, episodes)
}

#[test]
fn episodes_on_one_map_are_one_group() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = "seed = 100\nseeds = 3\nshuffle = 7";
    let records = configured(folder.path(), ("judge", run), 9);
    let samples = Samples::read(&[records]).expect("reads");
    assert!(samples.unconfigured.is_empty());
    let config = Run {
        seed: 100,
        seeds: 3,
        shuffle: 7,
        ..Run::default()
    };
    let groups: Vec<_> = samples.samples.iter().map(|sample| sample.group).collect();
    for (index, group) in groups.iter().enumerate() {
        let seed = config.episode_seed(index as u32 / 20);
        assert_eq!(*group, Group::Map(seed), "question {index}");
    }
    assert!(groups.iter().all(|group| *group <= Group::Map(102)));
}

#[test]
fn earlier_records_are_not_read_with_the_configuration_of_a_later_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let before = configured(folder.path(), ("judge-before", "seed = 100"), 1);
    let replayed = configured(folder.path(), ("judge-before/replay", "seed = 100"), 1);
    for records in [before, replayed] {
        let samples = Samples::read(std::slice::from_ref(&records)).expect("reads");
        assert_eq!(samples.unconfigured, [records]);
        let group = Group::Episode { run: 0, episode: 0 };
        assert_eq!(samples.samples[0].group, group);
    }
    let replayed = configured(folder.path(), ("judge/replay", "seed = 100"), 1);
    let samples = Samples::read(&[replayed]).expect("reads");
    assert_eq!(samples.samples[0].group, Group::Map(100));
}

#[test]
fn a_test_on_a_map_or_a_judge_of_its_own_is_needed() {
    let [one, other, unknown] = [(); 3].map(|()| tempfile::tempdir().expect("a folder"));
    let of = |folder: &Path, run: &str| {
        let records = configured(folder, ("judge", run), 3);
        Samples::read(&[records]).expect("reads")
    };
    let learned = of(one.path(), "seed = 100");
    let overlapping = of(other.path(), "seed = 102");
    let reason = overlapping.check_apart(&learned).expect_err("refused");
    let reason = reason.to_string();
    assert!(
        reason.contains("1 map") && reason.contains("seed 102"),
        "{reason}"
    );
    let mut tests = of(other.path(), "seed = 103");
    tests.check_apart(&learned).expect("other maps");
    // The maps of runs without a configuration are unknown.
    let unknown = Samples::read(&[recorded(unknown.path(), 1, 3)]).expect("reads");
    unknown.check_apart(&unknown).expect("nothing to compare");
    tests.teacher.judge = "vlm".into();
    let reason = tests.check_apart(&learned).expect_err("refused");
    let reason = reason.to_string();
    assert!(
        reason.contains("by vlm") && reason.contains("by rules"),
        "{reason}"
    );
}

/// A question that a distilled judge was asked, with what became of it and the askings of a
/// model behind it.
fn distilled(
    draw: &mut Draw,
    (passed_on, audit): (Option<Unsure>, Option<&str>),
    askings: Vec<Asking>,
) -> Record {
    Record {
        judge: "distilled".into(),
        preset: "blind".into(),
        model: match askings.is_empty() {
            true => "distilled from vlm".into(),
            false => "a-model".into(),
        },
        latency_s: 0.5,
        askings,
        net: Some(NetOpinion {
            expert: Some(0.9),
            policy: Some(0.05),
            similar: Some(0.05),
            passed_on,
            audit: audit.map(String::from),
        }),
        ..question(draw, (0, 0))
    }
}

/// Reads these records.
fn samples(records: impl IntoIterator<Item = Record>) -> anyhow::Result<Samples> {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = Store::open(folder.path(), 1 << 24).expect("opens");
    for record in records {
        let question = store.begin(record, &[]);
        store.complete(question);
    }
    drop(store);
    Samples::read(&[folder.path().into()])
}

#[test]
fn behind_a_net_the_teacher_is_the_slow_judge() {
    let mut draw = Draw::new(1);
    let asked = || vec![asking(SHOWING, Reply::First, 0.9)];
    let doubt = (Some(Unsure::Doubt), None);
    let audited = (None, Some("expert"));
    let mut rules = || distilled(&mut draw, audited, Vec::new());
    let [rules, more] = [rules(), rules()];
    let unheard = distilled(&mut draw, (None, None), Vec::new());
    let model = distilled(&mut draw, doubt, asked());
    let mut audited = distilled(&mut draw, audited, asked());
    let teacher = |records: &[&Record]| {
        let samples = samples(records.iter().copied().cloned()).expect("reads");
        samples.teacher.words()
    };
    assert_eq!(teacher(&[&unheard, &rules, &more]), "rules");
    assert_eq!(
        teacher(&[&unheard, &model, &audited]),
        "vlm (a-model, prompt blind)"
    );
    assert_eq!(teacher(&[&unheard]), "");
    let mixed = samples([rules, model.clone()]).expect_err("refused");
    assert!(mixed.to_string().contains("one judge at a time"), "{mixed}");
    audited.model = "another".into();
    let mixed = samples([model, audited]).expect_err("refused");
    assert!(mixed.to_string().contains("another"), "{mixed}");
}

#[test]
fn tokens_and_latency_are_those_of_the_slow_judge() {
    let mut draw = Draw::new(1);
    let mut large = asking(SHOWING, Reply::First, 0.9);
    (large.tokens_in, large.tokens_out) = (u64::MAX, u64::MAX);
    let mut passed_on = distilled(&mut draw, (Some(Unsure::Doubt), None), vec![large; 2]);
    passed_on.latency_s = 2.0;
    let small = vec![asking(SHOWING, Reply::First, 0.9)];
    let audited = distilled(&mut draw, (None, Some("expert")), small);
    let asked = samples([passed_on, audited]).expect("reads").asked;
    assert_eq!(asked.tokens, [u64::MAX; 2]);
    assert_eq!(asked.latencies_s, [2.0], "not that of the net");
}
