//! How good a distilled judge is on questions that it has not learned from.

use gate::distilled::{DistilledNet, Opinion};
use gate::presentation::Party;
use serde::Serialize;
use shm_config::message::Preference;

use super::samples::Sample;
use crate::statistics::{Bin, Share, calibration_error};

/// Bins of the reliability diagram, of equal width from 0.5 to 1.
pub const BINS: usize = 10;
/// Shares passed on at which the curve is computed.
const CURVE: usize = 21;
/// The greatest share passed on of the curve.
const CURVE_MAX: f64 = 0.5;

/// A point of the curve: what is right of the rest when a share is passed on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Point {
    /// Share passed on, the least confident first.
    pub passed_on: f64,
    /// Answers of the net that are right, of the rest.
    pub net: Share,
    /// Answers of the teacher to the same questions that are right.
    pub teacher: Share,
}

/// Figures of one set of questions. *Right* is an answer that lets the driver drive whose
/// path is safer, where exactly one path really ends in an accident.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Questions.
    pub questions: usize,
    /// Questions of which exactly one path ends in an accident.
    pub decided: usize,
    /// Questions passed on.
    pub passed_on: Share,
    /// Of them those with a feature outside the training.
    pub novel: usize,
    /// The net's answers that are right, where it answers.
    pub net: Share,
    /// The teacher's answers that are right, where the net answers and the teacher does,
    /// too.
    pub teacher: Share,
    /// The net's answers to the same questions.
    pub net_beside: Share,
    /// The teacher's answers that are right, to all questions.
    pub teacher_alone: Share,
    /// Right answers of both together: the net's, and the teacher's where it is passed on.
    pub together: Share,
    /// The net's answers that let the same driver drive as the teacher's.
    pub with_teacher: Share,
    /// Mean of the share that is right where the expert's path is safer and of that where the
    /// policy's is, of the net, where it answers.
    pub net_balanced: Option<f64>,
    /// The same of the teacher, for the same questions.
    pub teacher_balanced: Option<f64>,
    /// Questions that the net answered and whose policy path alone ends in an accident: it
    /// lets the policy drive.
    pub net_missed: Share,
    /// The same of the teacher, for the same questions.
    pub teacher_missed: Share,
    /// Expected calibration error against what really happens, before anything is passed
    /// on.
    pub calibration_error: Option<f64>,
    /// The same against the teacher's answers.
    pub calibration_error_teacher: Option<f64>,
    /// The reliability diagram against what really happens.
    pub reliability: [Bin; BINS],
    /// The reliability diagram against the teacher's answers.
    pub reliability_teacher: [Bin; BINS],
    /// What is right over the share passed on.
    pub curve: Vec<Point>,
}

/// One question with the net's opinion and what is right.
struct Case {
    opinion: Option<Opinion>,
    is_sure: bool,
    teacher: Option<Party>,
    safer: Option<Party>,
}

impl Case {
    fn net(&self) -> Option<Party> {
        self.opinion.map(|opinion| match opinion.preference() {
            Preference::Expert => Party::Expert,
            Preference::Policy | Preference::Abstain => Party::Policy,
        })
    }

    /// How early it is passed on: the novel ones first, then by confidence.
    fn confidence(&self) -> f64 {
        self.opinion.map_or(0.0, |opinion| match opinion.is_novel {
            true => 0.0,
            false => opinion.confidence(),
        })
    }
}

/// Right answers among those given where it is known which one is right.
fn right(cases: &[&Case], of: fn(&Case) -> Option<Party>) -> Share {
    let known = cases
        .iter()
        .filter_map(|case| Some((of(case)?, case.safer?)));
    Share::of(known.map(|(said, safer)| said == safer))
}

/// The mean of the share that is right for each safer driver, so that always preferring
/// one is right in one half; `None` without questions of both.
fn balanced(cases: &[&Case], of: fn(&Case) -> Option<Party>) -> Option<f64> {
    let [expert, policy] = [Party::Expert, Party::Policy].map(|party| {
        let safer = cases.iter().filter(|case| case.safer == Some(party));
        Share::of(safer.filter_map(|case| Some(of(case)? == party)))
    });
    let is_known = expert.trials > 0 && policy.trials > 0;
    is_known.then(|| f64::midpoint(expert.mean(), policy.mean()))
}

/// Policy paths that alone end in an accident, and are let drive.
fn missed(cases: &[&Case], of: fn(&Case) -> Option<Party>) -> Share {
    let dangerous = cases
        .iter()
        .filter(|case| case.safer == Some(Party::Expert));
    Share::of(dangerous.filter_map(|case| Some(of(case)? == Party::Policy)))
}

impl Figures {
    /// Asks the net about all of these questions.
    pub fn of(net: &mut DistilledNet, samples: &[&Sample]) -> Self {
        let mut cases: Vec<Case> = samples
            .iter()
            .map(|sample| {
                let opinion = net.opinion(&sample.seen);
                Case {
                    opinion,
                    is_sure: opinion.is_some_and(|opinion| net.is_sure(&opinion)),
                    teacher: sample.answer.map(super::samples::Label::driver),
                    safer: sample.safer(),
                }
            })
            .collect();
        let all: Vec<&Case> = cases.iter().collect();
        let answered: Vec<&Case> = cases.iter().filter(|case| case.is_sure).collect();
        let both: Vec<&Case> = answered
            .iter()
            .copied()
            .filter(|case| case.teacher.is_some())
            .collect();
        let teacher: fn(&Case) -> Option<Party> = |case| case.teacher;
        let agrees = both
            .iter()
            .filter_map(|case| Some(case.net()? == case.teacher?));
        let reliability = reliability(&all, |case| case.safer);
        let reliability_teacher = self::reliability(&all, |case| case.teacher);
        let figures = Self {
            questions: cases.len(),
            decided: cases.iter().filter(|case| case.safer.is_some()).count(),
            passed_on: Share::of(cases.iter().map(|case| !case.is_sure)),
            novel: cases
                .iter()
                .filter(|case| case.opinion.is_some_and(|opinion| opinion.is_novel))
                .count(),
            net: right(&answered, Case::net),
            teacher: right(&both, teacher),
            net_beside: right(&both, Case::net),
            teacher_alone: right(&all, teacher),
            together: right(&all, |case| match case.is_sure {
                true => case.net(),
                false => case.teacher,
            }),
            with_teacher: Share::of(agrees),
            net_balanced: balanced(&both, Case::net),
            teacher_balanced: balanced(&both, teacher),
            net_missed: missed(&both, Case::net),
            teacher_missed: missed(&both, teacher),
            calibration_error: calibration_error(&reliability),
            calibration_error_teacher: calibration_error(&reliability_teacher),
            reliability,
            reliability_teacher,
            curve: Vec::new(),
        };
        cases.sort_by(|one, other| one.confidence().total_cmp(&other.confidence()));
        Self {
            curve: curve(&cases),
            ..figures
        }
    }
}

fn reliability(cases: &[&Case], right: fn(&Case) -> Option<Party>) -> [Bin; BINS] {
    let mut bins = [Bin::default(); BINS];
    for case in cases {
        let (Some(opinion), Some(said), Some(right)) = (case.opinion, case.net(), right(case))
        else {
            continue;
        };
        let confidence = opinion.confidence();
        let at = ((confidence - 0.5) * 2.0 * BINS as f64) as usize;
        bins[at.min(BINS - 1)].count(said == right, confidence);
    }
    bins
}

/// `cases` are sorted, the least confident first.
fn curve(cases: &[Case]) -> Vec<Point> {
    (0..CURVE)
        .map(|k| {
            let passed_on = CURVE_MAX * k as f64 / (CURVE - 1) as f64;
            let from = (passed_on * cases.len() as f64) as usize;
            let rest: Vec<&Case> = cases[from.min(cases.len())..].iter().collect();
            Point {
                passed_on,
                net: right(&rest, Case::net),
                teacher: right(&rest, |case| case.teacher),
            }
        })
        .collect()
}
