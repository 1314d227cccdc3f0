//! The geometric judge, judges that hang or fail, and injected faults.

use std::sync::mpsc;

use gate::advice::Advisor;
use gate::judge::{FaultyJudge, Rules};
use gate::query::{Answer, Failure, Immediate, Judge, Question, Threaded};
use shm_config::Instant;
use shm_config::config::{self, Gate, SafetyLimits, When};
use shm_config::message::{Judge as Kind, Observation, Preference, Proposal, Step};
use vehicle::{Action, Vehicle};

fn observation(speed_mps: f64) -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.header.taken_ns = 1;
    observation.ranges_m.fill(50.0);
    observation.road.left_m = 5.25;
    observation.road.right_m = 5.25;
    observation.ego.speed_mps = speed_mps;
    observation.checkpoints[0].x_body_m = 40.0;
    observation
}

fn step_at(taken_ns: u64, expert: Option<Action>, policy: Option<Action>) -> Step {
    let mut step = Step {
        expert: Proposal::new(expert),
        policy: Proposal::new(policy),
        ..Step::default()
    };
    step.observation = observation(5.0);
    step.observation.header.taken_ns = taken_ns;
    step.header.taken_ns = taken_ns;
    step
}

const SECOND: u64 = 1_000_000_000;
const STRAIGHT: Action = Action {
    steer: 0.0,
    pedal: 0.1,
};
const OFF_ROAD: Action = Action {
    steer: 1.0,
    pedal: 0.5,
};

fn rules() -> Advisor {
    let judge = Rules::new(Vehicle::default(), SafetyLimits::default());
    let config = Gate {
        when: When::Period,
        ..Gate::default()
    };
    Advisor::new(&config, Box::new(Immediate::new(judge)))
}

#[test]
fn rules_prefer_the_path_that_stays_on_the_road_and_abstain_without_a_pair() {
    let rows = [
        (Some(STRAIGHT), Some(OFF_ROAD), Preference::Expert),
        (Some(OFF_ROAD), Some(STRAIGHT), Preference::Policy),
        (Some(STRAIGHT), Some(STRAIGHT), Preference::Policy),
        (
            Some(STRAIGHT),
            Some(Action {
                steer: 0.0,
                pedal: -1.0,
            }),
            Preference::Expert,
        ),
        (Some(STRAIGHT), None, Preference::Abstain),
        (None, Some(STRAIGHT), Preference::Policy),
        (None, None, Preference::Abstain),
    ];
    for (expert, policy, expected) in rows {
        let advice = rules().consider(&step_at(SECOND, expert, policy), Instant(SECOND));
        assert_eq!(
            advice.preference(),
            expected,
            "{expert:?} against {policy:?}"
        );
        assert_eq!(advice.answers, 1);
    }
}

#[test]
fn rules_prefer_the_expert_to_a_policy_that_lags_at_any_speed() {
    let pedal = |pedal| Some(Action { steer: 0.0, pedal });
    let rows = [
        // From rest, with an expert that drives off slowly.
        (0.0, pedal(0.2), pedal(0.19), Preference::Policy),
        (0.0, pedal(0.2), pedal(0.0), Preference::Expert),
        (0.0, pedal(0.1), pedal(-0.5), Preference::Expert),
        // Both stand: neither falls behind.
        (0.0, pedal(-1.0), pedal(-0.5), Preference::Policy),
        // At a crawl: 0.9 m of 4 m.
        (2.0, pedal(0.3), pedal(0.0), Preference::Expert),
        // In motion: 0.3 m of 7.5 m, and 2.6 m.
        (5.0, pedal(0.0), pedal(-0.02), Preference::Policy),
        (5.0, pedal(0.0), pedal(-0.2), Preference::Expert),
    ];
    for (speed_mps, expert, policy, expected) in rows {
        let mut step = step_at(SECOND, expert, policy);
        step.observation.ego.speed_mps = speed_mps;
        let advice = rules().consider(&step, Instant(SECOND));
        assert_eq!(
            advice.preference(),
            expected,
            "{expert:?} against {policy:?} at {speed_mps} m/s"
        );
    }
}

#[test]
fn questions_come_at_the_papers_cadence_and_advice_expires() {
    let mut advisor = rules();
    let mut answers = Vec::new();
    for tick in 0..250u64 {
        let taken_ns = SECOND + tick * SECOND / 10;
        let step = step_at(taken_ns, Some(STRAIGHT), Some(STRAIGHT));
        let advice = advisor.consider(&step, Instant(taken_ns));
        answers.push(advice.answers);
        assert_eq!(
            advice.holds_until_ns,
            advice.question_taken_ns + 12 * SECOND
        );
    }
    let asked: Vec<_> = (1..250).filter(|&k| answers[k] > answers[k - 1]).collect();
    assert_eq!((answers[0], asked), (1, vec![100, 200]), "every 10 s");
    let mut next = step_at(40 * SECOND, Some(STRAIGHT), Some(STRAIGHT));
    next.observation.header.episode = 1;
    assert_eq!(
        advisor.consider(&next, Instant(40 * SECOND)).answers,
        4,
        "and in a new episode"
    );
}

struct Slow {
    go: mpsc::Receiver<Result<Preference, Failure>>,
}

impl Judge for Slow {
    fn kind(&self) -> Kind {
        Kind::Vlm
    }
    fn ask(&mut self, question: &Question) -> Answer {
        let preference = self.go.recv().unwrap_or_else(|_| panic!("the judge dies"));
        Answer {
            question: question.id(),
            preference,
            cost_usd: 0.01,
        }
    }
}

#[test]
fn a_judge_that_hangs_or_fails_delays_no_step_and_makes_no_label() {
    let (go, judge) = mpsc::channel();
    let mut advisor = Advisor::new(
        &Gate::default(),
        Box::new(Threaded::new(Slow { go: judge })),
    );
    let mut taken_ns = SECOND;
    let mut consider = |advisor: &mut Advisor| {
        taken_ns += SECOND / 10;
        let step = step_at(taken_ns, Some(STRAIGHT), Some(STRAIGHT));
        advisor.consider(&step, Instant(taken_ns))
    };
    // The judge hangs for three periods: every step is considered, and there is no
    // advice.
    for _ in 0..300 {
        assert_eq!(consider(&mut advisor).answers, 0);
    }
    let until_answered =
        |advisor: &mut Advisor,
         count: u64,
         consider: &mut dyn FnMut(&mut Advisor) -> shm_config::message::Advice| {
            loop {
                let advice = consider(advisor);
                if advice.answers == count {
                    return advice;
                }
                std::thread::yield_now();
            }
        };
    go.send(Ok(Preference::Policy)).unwrap();
    let advice = until_answered(&mut advisor, 1, &mut consider);
    assert_eq!(advice.preference(), Preference::Policy);
    assert_eq!(
        advice.question_taken_ns,
        SECOND + SECOND / 10,
        "the answer belongs to its question"
    );
    go.send(Err(Failure::Timeout)).unwrap();
    let advice = until_answered(&mut advisor, 2, &mut consider);
    assert_eq!(
        advice.preference(),
        Preference::Abstain,
        "a failure is never read as 0"
    );
    drop(go);
    let advice = until_answered(&mut advisor, 3, &mut consider);
    assert_eq!(
        advice.preference(),
        Preference::Abstain,
        "nor is that of a dead judge"
    );
}

/// A judge that always prefers the policy.
struct Content;

impl Judge for Content {
    fn kind(&self) -> Kind {
        Kind::Rules
    }

    fn ask(&mut self, question: &Question) -> Answer {
        Answer::free(question.id(), Preference::Policy)
    }
}

/// Asks a faulty judge once a second.
fn faulty(faults: &config::FaultyJudge) -> Advisor {
    let config = Gate {
        period_s: 1.0,
        ..Gate::default()
    };
    let judge = Box::new(Immediate::new(Content));
    Advisor::new(&config, Box::new(FaultyJudge::new(faults, judge)))
}

/// The preferences heard for 2,000 questions, one a second.
fn heard(faults: &config::FaultyJudge) -> Vec<Preference> {
    let mut advisor = faulty(faults);
    let answers = (1..=2000u64).map(|k| {
        let mut step = Step {
            observation: observation(5.0),
            ..Step::default()
        };
        step.observation.header.tick = 10 * k;
        step.observation.header.taken_ns = k * 1_000_000_000;
        let now = Instant(k * 1_000_000_000);
        let advice = advisor.consider(&step, now);
        (advice.answers, advice.label())
    });
    let mut last = 0;
    let mut heard = Vec::new();
    for (answers, preference) in answers {
        if answers > last {
            heard.push(preference);
        }
        last = answers;
    }
    heard
}

#[test]
fn noise_inverts_and_abstention_withholds_the_configured_share_of_answers() {
    let faults = config::FaultyJudge {
        noise: 0.3,
        abstention: 0.2,
        ..config::FaultyJudge::default()
    };
    let answers = heard(&faults);
    assert_eq!(answers.len(), 2000);
    let share = |wanted| {
        let count = answers.iter().filter(|&&preference| preference == wanted);
        count.count() as f64 / 2000.0
    };
    // Four standard deviations of a share of 2,000.
    assert!((share(Preference::Abstain) - 0.2).abs() < 0.04);
    assert!((share(Preference::Expert) - 0.8 * 0.3).abs() < 0.04);
    assert_eq!(answers, heard(&faults), "the same seed, the same faults");
    let other = config::FaultyJudge { seed: 1, ..faults };
    assert_ne!(answers, heard(&other), "another seed, other faults");
}

#[test]
fn a_late_answer_is_heard_late_and_keeps_its_question() {
    let mut advisor = faulty(&config::FaultyJudge {
        delay_s: 30.0,
        ..config::FaultyJudge::default()
    });
    for k in 1..=60u64 {
        let mut step = Step {
            observation: observation(5.0),
            ..Step::default()
        };
        step.observation.header.taken_ns = k * 1_000_000_000;
        let advice = advisor.consider(&step, Instant(k * 1_000_000_000));
        let about = k.saturating_sub(30);
        assert_eq!(advice.answers, about, "after {k} s");
        assert_eq!(advice.question_taken_ns, about * 1_000_000_000);
    }
}
