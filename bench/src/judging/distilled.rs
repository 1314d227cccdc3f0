//! How long one answer of a distilled judge takes, features included, and how often it is
//! right.

use std::path::Path;

use gate::distilled::{DistilledNet, read};
use gate::presentation::Party;
use gate::query::Question;
use hdrhistogram::Histogram;
use judge::statistics::Share;
use serde::Serialize;
use shm_config::message::{Assessment, Observation, Preference, Proposal};
use stack::Clock;
use supervisor::subcommand::say;
use vehicle::{Action, Vehicle};

use super::scenes::Scene;

/// Answers to each scene: the first fills the caches, as the first one in a drive does,
/// and counts like all others.
const REPEATS: usize = 50;
/// Longest answer that the histogram holds, ns.
const LONGEST_NS: u64 = 10_000_000_000;

/// A distilled judge under test.
pub struct Meter {
    net: DistilledNet,
    vehicle: Vehicle,
    clock: Clock,
    times_ns: Histogram<u64>,
    right: Share,
    passed_on: Share,
}

/// The figures of a distilled judge.
#[derive(Debug, Clone, Serialize)]
pub struct Distilled {
    /// Answers that were timed.
    pub answers: u64,
    /// Median time of an answer, us.
    pub answer_p50_us: f64,
    /// 99 % quantile, us.
    pub answer_p99_us: f64,
    /// Maximum, us.
    pub answer_max_us: f64,
    /// Share of the scenes that the net passes on.
    pub passed_on: Share,
    /// Share of its answers that let the safer driver drive.
    pub right: Share,
}

impl Meter {
    /// Reads the net of a file.
    ///
    /// # Errors
    /// If the file is refused.
    pub fn open(path: &Path, vehicle: Vehicle, clock: Clock) -> anyhow::Result<Self> {
        Ok(Self {
            net: read(path)?,
            vehicle,
            clock,
            times_ns: Histogram::new_with_max(LONGEST_NS, 3)?,
            right: Share::default(),
            passed_on: Share::default(),
        })
    }

    /// Asks about a scene.
    pub fn ask(&mut self, scene: &Scene) {
        let [expert, policy] = scene.proposed.map(|proposed| {
            Proposal::new(Some(Action {
                steer: proposed.steer,
                pedal: proposed.pedal,
            }))
        });
        let question = Question {
            observation: Observation::clone(&scene.observation),
            expert,
            policy,
            expert_assessment: Assessment::default(),
            policy_assessment: Assessment::default(),
        };
        let mut opinion = None;
        for _ in 0..REPEATS {
            let begun = (self.clock)();
            opinion = std::hint::black_box(self.net.judge(&question, &self.vehicle));
            let took_ns = (self.clock)().since_ns(begun);
            self.times_ns.saturating_record(took_ns);
        }
        let sure = opinion.filter(|opinion| self.net.is_sure(opinion));
        self.passed_on.trials += 1;
        self.passed_on.hits += usize::from(sure.is_none());
        if let Some(opinion) = sure {
            let is_expert = opinion.preference() == Preference::Expert;
            self.right.trials += 1;
            self.right.hits += usize::from(is_expert == (scene.safer() == Party::Expert));
        }
    }

    /// The figures so far.
    pub fn figures(&self) -> Distilled {
        let at_us = |quantile| self.times_ns.value_at_quantile(quantile) as f64 * 1e-3;
        Distilled {
            answers: self.times_ns.len(),
            answer_p50_us: at_us(0.5),
            answer_p99_us: at_us(0.99),
            answer_max_us: self.times_ns.max() as f64 * 1e-3,
            passed_on: self.passed_on,
            right: self.right,
        }
    }
}

/// Prints the figures.
pub fn print(figures: &Distilled) {
    say(format_args!(
        "the distilled judge: {} answers, p50 {:.0} us, p99 {:.0} us, max {:.0} us; passed on {} of {} \
         scenes; right {} of {}",
        figures.answers,
        figures.answer_p50_us,
        figures.answer_p99_us,
        figures.answer_max_us,
        figures.passed_on.hits,
        figures.passed_on.trials,
        figures.right.hits,
        figures.right.trials,
    ));
}
