//! The distilled judge: what its file must hold, when it passes a question on, and that
//! no failure becomes a preference.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::mpsc::{Receiver, channel};

use gate::advice::Advisor;
use gate::distilled::{
    About, DistilledNet, INPUTS, OUTPUTS, Range, assemble, decode, encode, read,
};
use gate::judge::Distilled;
use gate::query::{Answer, Failure, QueryQueue, Question};
use gate::record::{Evidence, Unsure};
use policy::{Activation, Layer};
use shm_config::Instant;
use shm_config::config::Gate;
use shm_config::message::{Judge as Kind, Observation, Preference, Proposal, Step};
use vehicle::{Action, Vehicle};

const SECOND: u64 = 1_000_000_000;
/// Place of the pedal among the features: behind 16 of the scene, 48 sectors and the
/// steering.
const PEDAL: usize = 65;

fn about(threshold: f64) -> About {
    About {
        members: 1,
        temperature: 1.0,
        threshold,
        range: Range {
            low: vec![-2.0; INPUTS],
            high: vec![2.0; INPUTS],
        },
        teacher: "rules".into(),
        preset: String::new(),
        model: String::new(),
        learned: "answers".into(),
        questions: 100,
        seed: 0,
        commit: "0123abcd".into(),
    }
}

/// A net that finds the proposal with more pedal safer, and is in doubt where both have
/// the same.
fn layers() -> Vec<Layer> {
    let mut weights = vec![0.0; OUTPUTS * INPUTS];
    weights[PEDAL] = 10.0;
    vec![Layer {
        weights,
        bias: vec![0.0; OUTPUTS],
        inputs: INPUTS,
        outputs: OUTPUTS,
        activation: Activation::None,
    }]
}

fn net(threshold: f64) -> DistilledNet {
    assemble(layers(), about(threshold)).expect("a net")
}

fn step(tick: u64, [expert, policy]: [f64; 2]) -> Step {
    let proposal = |pedal| Proposal::new(Some(Action { steer: 0.0, pedal }));
    let mut step = Step {
        expert: proposal(expert),
        policy: proposal(policy),
        ..Step::default()
    };
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.ranges_m.fill(50.0);
    (observation.road.left_m, observation.road.right_m) = (5.0, 5.0);
    observation.ego.speed_mps = 5.0;
    observation.checkpoints[0].x_body_m = 40.0;
    observation.header.tick = tick;
    observation.header.taken_ns = SECOND * (1 + tick);
    step.header = observation.header;
    step.observation = observation;
    step
}

/// A slow judge whose answers are written down.
struct Scripted {
    answers: Vec<Result<Preference, Failure>>,
    asked: VecDeque<Question>,
    is_full: bool,
}

impl QueryQueue for Scripted {
    fn kind(&self) -> Kind {
        Kind::Vlm
    }

    fn put(&mut self, question: Question) -> bool {
        if !self.is_full {
            self.asked.push_back(question);
        }
        !self.is_full
    }

    fn take(&mut self, _: Instant) -> Option<Answer> {
        let question = self.asked.pop_front()?;
        let preference = self.answers.pop().expect("an answer is written down");
        Some(Answer {
            question: question.id(),
            preference,
            cost_usd: 0.5,
        })
    }

    fn awaited(&self) -> usize {
        self.asked.len()
    }
}

fn clock() -> Instant {
    Instant(0)
}

/// An advisor with a distilled judge that is sure from 0.9 on, and its evidence.
fn advisor(
    net: DistilledNet,
    answers: &[Result<Preference, Failure>],
    audit: f64,
) -> (Advisor, Receiver<Evidence>) {
    let (sender, evidence) = channel();
    let slow = Scripted {
        answers: answers.iter().rev().copied().collect(),
        asked: VecDeque::new(),
        is_full: false,
    };
    let judge = Distilled::new(
        (net, Vehicle::default()),
        Box::new(slow),
        audit,
        (sender, clock),
    );
    let config = Gate {
        period_s: 1.0,
        dwell_s: 0.0,
        ..Gate::default()
    };
    (Advisor::new(&config, Box::new(judge)), evidence)
}

fn consider(advisor: &mut Advisor, tick: u64, pedals: [f64; 2]) -> (Preference, u64) {
    let step = step(tick, pedals);
    let advice = advisor.consider(&step, step.observation.header.taken());
    assert!(matches!(advice.judge, 0 | 6), "none or distilled");
    (advice.label(), advice.answers)
}

#[test]
fn what_is_written_is_read_again() {
    let bytes = encode(&net(0.9));
    let mut read = decode(&bytes).expect("a good file");
    assert_eq!(read.about, about(0.9));
    let rows = [[0.3; INPUTS], [0.1; INPUTS]];
    assert_eq!(read.opinion(&rows), net(0.9).opinion(&rows));
    assert_eq!(bytes, encode(&read));
}

#[test]
fn another_file_is_refused_with_what_is_wrong() {
    let good = encode(&net(0.9));
    let text = |bytes: &[u8]| decode(bytes).expect_err("refused").to_string();
    let replaced = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = good
            .windows(from.len())
            .position(|window| window == from.as_bytes())
            .expect("in the file");
        let mut bytes = good.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        text(&bytes)
    };
    assert!(text(&[]).contains("empty"));
    assert!(text(b"# a text file\n").contains("not an ONNX file"));
    for part in [good.len() / 8, good.len() / 2, good.len() - 1] {
        let reason = text(&good[..part]);
        assert!(reason.contains("truncated"), "{part} bytes: {reason}");
    }
    let large = vec![8; shm_config::message::WEIGHTS_BYTES_MAX + 1];
    assert!(text(&large).contains("over the limit"));
    let policy = std::fs::read("../results/learning/ppl-10000.onnx").expect("a policy");
    let reason = text(&policy);
    assert!(
        reason.contains("kind") && reason.contains("policy"),
        "{reason}"
    );
    assert!(replaced("vlaps.kind\u{12}\u{5}judge", "vlaps.kind\u{12}\u{5}juggl").contains("kind"));
    let layout = replaced("judge.layout\u{12}\u{10}", "judge.layoux\u{12}\u{10}");
    assert!(
        layout.contains("layout") && layout.contains("missing"),
        "{layout}"
    );
    // Weights that are no numbers, and a flipped bit of a good one.
    let weight = 10.0_f32.to_le_bytes();
    let at = good
        .windows(4)
        .rposition(|four| four == weight)
        .expect("the weight");
    let mut broken = good.clone();
    broken[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(text(&broken).contains("not finite"));
    let mut flipped = good.clone();
    flipped[at] ^= 1;
    assert!(text(&flipped).contains("has changed"));
    let mut other = about(0.9);
    other.members = 2;
    let reason = assemble(layers(), other).expect_err("refused").to_string();
    assert!(reason.contains("wrong shape"), "{reason}");
    for threshold in [f64::NAN, 0.2, 9.0] {
        let reason = text(&encode(&net(threshold)));
        assert!(reason.contains("threshold"), "{reason}");
    }
}

#[test]
fn a_distilled_judge_is_no_policy() {
    let reason = policy::decode(&encode(&net(0.9)))
        .expect_err("refused")
        .to_string();
    assert!(
        reason.contains("kind") && reason.contains("judge"),
        "{reason}"
    );
}

#[test]
fn a_sure_net_answers_at_once_and_the_slow_judge_is_not_asked() {
    let (mut advisor, evidence) = advisor(net(0.9), &[], 0.0);
    assert_eq!(
        consider(&mut advisor, 0, [0.5, -0.5]),
        (Preference::Expert, 1)
    );
    assert_eq!(
        consider(&mut advisor, 1, [-0.5, 0.5]),
        (Preference::Policy, 2)
    );
    for evidence in evidence.try_iter() {
        let net = evidence.net.expect("an opinion");
        assert_eq!((net.passed_on, evidence.follow), (None, 0));
    }
    assert_eq!(advisor.cost_usd(), 0.0);
}

#[test]
fn doubt_and_novelty_are_passed_on() {
    let answers = [Ok(Preference::Expert), Ok(Preference::Policy)];
    let (mut advisor, evidence) = advisor(net(0.9), &answers, 0.0);
    assert_eq!(
        consider(&mut advisor, 0, [0.1, 0.1]),
        (Preference::Expert, 1)
    );
    assert_eq!(
        consider(&mut advisor, 1, [0.1, 0.1]),
        (Preference::Policy, 2)
    );
    assert_eq!(advisor.cost_usd(), 1.0);
    for evidence in evidence.try_iter() {
        let net = evidence.net.expect("an opinion");
        assert_eq!((net.passed_on, evidence.follow), (Some(Unsure::Doubt), 1));
    }
    let mut strange = net(0.9);
    strange.about.range.high[PEDAL] = 0.0;
    let (mut advisor, evidence) = self::advisor(strange, &[Ok(Preference::Policy)], 0.0);
    assert_eq!(
        consider(&mut advisor, 0, [0.9, -0.9]),
        (Preference::Policy, 1),
        "the slow judge's answer, although the net would be sure"
    );
    let net = evidence.try_iter().next().and_then(|evidence| evidence.net);
    assert_eq!(net.expect("an opinion").passed_on, Some(Unsure::Novel));
}

#[test]
fn a_failure_behind_the_net_is_no_preference() {
    let answers = [Err(Failure::Timeout), Ok(Preference::Abstain)];
    let (mut advisor, _evidence) = advisor(net(0.9), &answers, 0.0);
    assert_eq!(
        consider(&mut advisor, 0, [0.1, 0.1]),
        (Preference::Abstain, 1)
    );
    assert_eq!(
        consider(&mut advisor, 1, [0.1, 0.1]),
        (Preference::Abstain, 2)
    );
}

#[test]
fn a_scan_that_the_net_does_not_know_is_passed_on() {
    let (mut advisor, evidence) = advisor(net(0.9), &[Err(Failure::Unavailable)], 0.0);
    let mut step = step(0, [0.5, -0.5]);
    step.observation.beam_count = 60;
    let advice = advisor.consider(&step, step.observation.header.taken());
    assert_eq!((advice.label(), advice.answers), (Preference::Abstain, 1));
    let net = evidence.try_iter().next().and_then(|evidence| evidence.net);
    let net = net.expect("an opinion");
    assert_eq!((net.passed_on, net.expert), (Some(Unsure::Unfit), None));
}

#[test]
fn an_overflow_in_the_net_is_no_opinion() {
    let mut layers = layers();
    // Finite for equal inputs, as the file's check gives them; infinite where steering and
    // pedal differ in sign.
    (layers[0].weights[PEDAL], layers[0].weights[PEDAL - 1]) = (3e38, -3e38);
    let net = assemble(layers, about(0.9)).expect("a net");
    let net = decode(&encode(&net)).expect("a good file");
    let (mut advisor, evidence) = advisor(net, &[Err(Failure::Unavailable)], 0.0);
    let mut step = step(0, [1.0, 0.0]);
    step.expert.steer = -1.0;
    let advice = advisor.consider(&step, step.observation.header.taken());
    assert_eq!((advice.label(), advice.answers), (Preference::Abstain, 1));
    let net = evidence.try_iter().next().and_then(|evidence| evidence.net);
    let net = net.expect("an opinion");
    assert_eq!((net.passed_on, net.expert), (Some(Unsure::Unfit), None));
}

#[test]
fn an_audit_is_recorded_and_has_no_effect() {
    let answers = [Ok(Preference::Policy), Err(Failure::Timeout)];
    let (mut advisor, evidence) = advisor(net(0.9), &answers, 1.0);
    assert_eq!(
        consider(&mut advisor, 0, [0.5, -0.5]),
        (Preference::Expert, 1)
    );
    assert_eq!(
        consider(&mut advisor, 1, [0.5, -0.5]),
        (Preference::Expert, 2)
    );
    assert_eq!(
        consider(&mut advisor, 1, [0.5, -0.5]),
        (Preference::Expert, 2)
    );
    let all: Vec<_> = evidence.try_iter().collect();
    let audits: Vec<_> = all.iter().filter_map(|evidence| evidence.audit).collect();
    assert_eq!(audits, [Some(Preference::Policy), None]);
    // The slow judge's evidence and the audit's result.
    assert!(
        all.iter()
            .filter(|e| e.net.is_some())
            .all(|e| e.follow == 2)
    );
    assert_eq!(
        advisor.cost_usd(),
        1.0,
        "an audit costs what a question costs"
    );
}

/// A slow judge that has room for so many questions, and answers none of them yet.
struct Silent {
    capacity: usize,
    open: usize,
}

impl QueryQueue for Silent {
    fn kind(&self) -> Kind {
        Kind::Rules
    }

    fn put(&mut self, _: Question) -> bool {
        let has_room = self.open < self.capacity;
        self.open += usize::from(has_room);
        has_room
    }

    fn take(&mut self, _: Instant) -> Option<Answer> {
        None
    }

    fn awaited(&self) -> usize {
        self.open
    }
}

#[test]
fn audits_leave_room_for_a_doubtful_question() {
    let (sender, evidence) = channel();
    let slow = Silent {
        capacity: 2,
        open: 0,
    };
    let nets = (net(0.9), Vehicle::default());
    let mut judge = Distilled::new(nets, Box::new(slow), 1.0, (sender, clock));
    assert!(judge.put(Question::about(&step(0, [0.5, -0.5]))), "audited");
    assert!(judge.put(Question::about(&step(1, [0.5, -0.5]))), "sure");
    assert!(judge.put(Question::about(&step(2, [0.1, 0.1]))), "in doubt");
    let follow: Vec<_> = evidence.try_iter().map(|piece| piece.follow).collect();
    assert_eq!(follow, [1, 0, 0], "the audit's result alone");
}

/// A judge whose answers are delayed, so that no run in lockstep waits for them.
struct Late {
    asked: VecDeque<Question>,
    due: Instant,
}

impl QueryQueue for Late {
    fn kind(&self) -> Kind {
        Kind::Rules
    }

    fn put(&mut self, question: Question) -> bool {
        self.asked.push_back(question);
        true
    }

    fn take(&mut self, now: Instant) -> Option<Answer> {
        let question = (now >= self.due)
            .then(|| self.asked.pop_front())
            .flatten()?;
        Some(Answer::free(question.id(), Preference::Policy))
    }

    fn awaited(&self) -> usize {
        0
    }
}

#[test]
fn no_audit_is_forgotten_while_its_answer_is_delayed() {
    // As many as `FaultyJudge` delays, and `gate.in_flight` at its maximum.
    const OPEN: u64 = 64 + 16;
    let (sender, evidence) = channel();
    let due = Instant(SECOND);
    let slow = Late {
        asked: VecDeque::new(),
        due,
    };
    let nets = (net(0.9), Vehicle::default());
    let mut judge = Distilled::new(nets, Box::new(slow), 1.0, (sender, clock));
    for tick in 0..OPEN {
        assert!(judge.put(Question::about(&step(tick, [0.5, -0.5]))));
        let answer = judge.take(Instant(0)).expect("the net's answer");
        assert_eq!(answer.preference, Ok(Preference::Expert));
    }
    assert_eq!(judge.take(due), None, "an audit decides nothing");
    let audits = evidence.try_iter().filter(|piece| piece.audit.is_some());
    assert_eq!(audits.count() as u64, OPEN);
}

#[test]
fn a_pipe_and_an_endless_file_are_refused_at_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let pipe = folder.path().join("judge.onnx");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.is_ok_and(|status| status.success()), "a pipe");
    for path in [Path::new("/dev/zero"), &pipe] {
        let reason = read(path).expect_err("refused").to_string();
        assert!(reason.contains("is no regular file"), "{reason}");
    }
}

#[test]
fn with_a_full_queue_the_net_still_answers_and_doubt_is_asked_again() {
    let (sender, evidence) = channel();
    let slow = Scripted {
        answers: Vec::new(),
        asked: VecDeque::new(),
        is_full: true,
    };
    let mut judge = Distilled::new(
        (net(0.9), Vehicle::default()),
        Box::new(slow),
        1.0,
        (sender, clock),
    );
    assert!(judge.put(Question::about(&step(0, [0.5, -0.5]))));
    assert!(judge.take(Instant(1)).is_some());
    assert!(!judge.put(Question::about(&step(1, [0.1, 0.1]))));
    let follow: Vec<_> = evidence
        .try_iter()
        .map(|evidence| evidence.follow)
        .collect();
    assert_eq!(
        follow,
        [0],
        "nothing follows, and the refused question left no trace"
    );
}
