//! Tests when a judge is asked, which driver its answers choose, and which labels they
//! make.

use gate::advice::Advisor;
use gate::judge::FaultyJudge;
use gate::query::{Answer, Failure, Immediate, Judge, Occasion, QueryQueue, Question, Threaded};
use shm_config::Instant;
use shm_config::config::{self, Gate, When};
use shm_config::message::{Advice, Judge as Kind, Preference, Proposal, Step};
use vehicle::Action;

const PERIOD_NS: u64 = 100_000_000;
const CALM: Action = Action {
    steer: 0.0,
    pedal: 0.2,
};
const FAR: f64 = 20.0;

/// A step in which both drivers propose; the tick number is also its time.
fn step(tick: u64, policy: Action, clearance_m: f64) -> Step {
    let mut step = Step {
        expert: Proposal::new(Some(CALM)),
        policy: Proposal::new(Some(policy)),
        ..Step::default()
    };
    step.header.tick = tick;
    step.header.taken_ns = tick * PERIOD_NS;
    step.header.sequence = tick;
    step.observation.header = step.header;
    step.expert_assessment.clearance_m = FAR;
    step.policy_assessment.clearance_m = clearance_m;
    step
}

fn calm(tick: u64) -> Step {
    step(tick, CALM, FAR)
}

/// A judge that gives the answers of a script; the last one repeats.
struct Script(Vec<Result<Preference, Failure>>);

impl Judge for Script {
    fn kind(&self) -> Kind {
        Kind::Vlm
    }

    fn ask(&mut self, question: &Question) -> Answer {
        let preference = match self.0.len() {
            1 => self.0[0],
            _ => self.0.remove(0),
        };
        Answer {
            question: question.id(),
            preference,
            cost_usd: 0.01,
        }
    }
}

fn scripted(answers: &[Result<Preference, Failure>]) -> Box<dyn QueryQueue> {
    Box::new(Immediate::new(Script(answers.to_vec())))
}

fn run(advisor: &mut Advisor, steps: impl IntoIterator<Item = Step>) -> Vec<Advice> {
    let mut advise = |step: Step| advisor.consider(&step, Instant(step.header.taken_ns));
    steps.into_iter().map(&mut advise).collect()
}

#[test]
fn a_question_is_asked_when_it_matters_and_never_more_often_than_the_spacing() {
    let apart = Action { steer: 0.5, ..CALM };
    let rows = [
        (When::Period, step(5, apart, FAR), None),
        (When::Matters, calm(25), None),
        (When::Matters, step(25, apart, FAR), Some(Occasion::Differ)),
        (
            When::Matters,
            step(25, CALM, 0.2),
            Some(Occasion::Clearance),
        ),
        (When::Matters, step(5, apart, 0.2), None),
        (When::Period, step(101, CALM, FAR), Some(Occasion::Period)),
    ];
    for (when, second, expected) in rows {
        let config = Gate {
            when,
            ..Gate::default()
        };
        let mut advisor = Advisor::new(&config, scripted(&[Ok(Preference::Policy)]));
        let first = advisor.ask(&calm(1));
        assert_eq!(first, Some(Occasion::Episode));
        let tick = second.header.tick;
        let occasion = advisor.ask(&second);
        assert_eq!(occasion, expected, "{when:?}, tick {tick}");
    }
}

#[test]
fn a_model_is_not_asked_where_there_is_no_choice() {
    let mut advisor = Advisor::new(&Gate::default(), scripted(&[Ok(Preference::Policy)]));
    for half in [
        Step {
            policy: Proposal::default(),
            ..calm(1)
        },
        Step {
            expert: Proposal::default(),
            ..calm(2)
        },
    ] {
        assert!(advisor.ask(&half).is_none());
    }
    assert!(advisor.ask(&calm(3)).is_some());
}

#[test]
fn the_expert_drives_at_once_and_the_policy_after_the_dwell_time() {
    let config = Gate {
        when: When::Period,
        period_s: 0.1,
        dwell_s: 1.0,
        confirmations: 2,
        ..Gate::default()
    };
    let mut script = vec![Ok(Preference::Policy); 3];
    script.push(Ok(Preference::Expert));
    script.push(Ok(Preference::Policy));
    let mut advisor = Advisor::new(&config, scripted(&script));
    let advice = run(&mut advisor, (1..30).map(calm));
    let preferred: Vec<Preference> = advice.iter().map(Advice::preference).collect();
    assert_eq!(preferred[0], Preference::Abstain, "one answer is too few");
    assert_eq!(preferred[1..3], [Preference::Policy; 2]);
    assert_eq!(preferred[3..13], [Preference::Expert; 10], "a second");
    assert!(preferred[13..].iter().all(|&p| p == Preference::Policy));
    assert_eq!(
        advice[5].label(),
        Preference::Policy,
        "the answer still makes a label"
    );
}

#[test]
fn after_a_failure_or_an_abstention_the_policy_stops_driving_at_once() {
    for answer in [Ok(Preference::Abstain), Err(Failure::Malformed)] {
        let config = Gate {
            when: When::Period,
            period_s: 0.1,
            ..Gate::default()
        };
        let mut advisor = Advisor::new(&config, scripted(&[Ok(Preference::Policy), answer]));
        let advice = run(&mut advisor, (1..4).map(calm));
        assert_eq!(advice[0].preference(), Preference::Policy);
        assert_eq!(advice[1].preference(), Preference::Abstain);
        assert_eq!(advice[1].label(), Preference::Abstain, "{answer:?}");
    }
}

#[test]
fn an_answer_about_another_episode_is_no_advice_in_this_one() {
    let faults = config::FaultyJudge {
        delay_s: 1.0,
        ..config::FaultyJudge::default()
    };
    let queue = FaultyJudge::new(&faults, scripted(&[Ok(Preference::Policy)]));
    let mut advisor = Advisor::new(&Gate::default(), Box::new(queue));
    let first = run(&mut advisor, (1..6).map(calm));
    assert!(first.iter().all(|advice| advice.answers == 0));
    let second = (6..16).map(|tick| {
        let mut step = calm(tick);
        step.header.episode = 1;
        step.observation.header.episode = 1;
        step
    });
    let advice = run(&mut advisor, second);
    let heard = advice.iter().find(|advice| advice.answers == 1);
    let heard = heard.expect("the answer of the first episode");
    assert_eq!(heard.label(), Preference::Policy, "it teaches");
    assert_eq!(
        heard.preference(),
        Preference::Abstain,
        "and decides nothing"
    );
}

#[test]
fn an_overtaken_answer_makes_a_label_and_decides_nothing() {
    let (ask_first, first) = std::sync::mpsc::channel::<()>();
    // Two questions at once: the first answer is held back until the second was heard.
    let queue = Threaded::served(
        Kind::Vlm,
        2,
        Box::new(move |questions, answers| {
            let early = questions.recv().unwrap();
            let late = questions.recv().unwrap();
            let answer = |question: Question, preference| Answer::free(question.id(), preference);
            answers.send(answer(late, Preference::Expert)).unwrap();
            first.recv().unwrap();
            answers.send(answer(early, Preference::Policy)).unwrap();
            let _ = questions.recv();
        }),
    );
    let config = Gate {
        when: When::Period,
        period_s: 0.1,
        ..Gate::default()
    };
    let mut advisor = Advisor::new(&config, Box::new(queue));
    advisor.ask(&calm(1)).unwrap();
    advisor.ask(&calm(2)).unwrap();
    assert!(advisor.ask(&calm(3)).is_none(), "two are on their way");
    let now = Instant(3 * PERIOD_NS);
    while advisor.hear(now).is_none() {
        std::thread::yield_now();
    }
    ask_first.send(()).unwrap();
    while advisor.hear(now).is_none() {
        std::thread::yield_now();
    }
    let advice = advisor.advise(now);
    assert_eq!(advice.answers, 2);
    assert_eq!(
        (advice.question_tick, advice.preference()),
        (2, Preference::Expert)
    );
    assert_eq!(advice.label_from_ns, PERIOD_NS);
    assert_eq!(advice.label(), Preference::Policy);
}
