//! Advice is dated by the tick that it is about, so that a judge needs no clock.
//!
//! The vehicle remembers when it drove each of its last ticks. Of advice that comes it takes
//! episode and tick, and writes its own times beside them: an answer holds for as long after
//! its question as if the judge stood beside the car, however wrong the judge's clock is.
//! Advice about a tick that this run has not driven is refused.

use std::collections::VecDeque;

use shm_config::Instant;
use shm_config::config::Gate;
use shm_config::message::{Advice, Step};

use crate::refusal::Reason;

/// Ticks that are remembered: at 100 Hz 80 s, longer than any answer of a model takes.
const TICKS: usize = 8192;

#[derive(Debug, Clone, Copy)]
struct Driven {
    episode: u32,
    /// The step's tick, and when it was taken, ns on the run's clock.
    step: (u64, u64),
    /// The same of its observation, about which a judge is asked.
    observation: (u64, u64),
}

/// When each of the last ticks was driven.
#[derive(Debug)]
pub struct Dating {
    ticks: VecDeque<Driven>,
    hold_ns: u64,
    label_ns: u64,
}

impl Dating {
    /// Nothing is driven yet.
    pub fn new(gate: &Gate) -> Self {
        Self {
            ticks: VecDeque::with_capacity(TICKS),
            hold_ns: (gate.hold_s * 1e9) as u64,
            label_ns: gate.label_ns(),
        }
    }

    /// Remembers a step of this run.
    pub fn note(&mut self, step: &Step) {
        let header = step.observation.header;
        if self.ticks.len() == TICKS {
            self.ticks.pop_front();
        }
        self.ticks.push_back(Driven {
            episode: step.header.episode,
            step: (step.header.tick, step.header.taken_ns),
            observation: (header.tick, header.taken_ns),
        });
    }

    fn find(&self, matches: impl Fn(&Driven) -> bool) -> Option<&Driven> {
        // What comes is about one of the newest ticks.
        self.ticks.iter().rev().find(|driven| matches(driven))
    }

    /// Writes the times of this machine into advice. `now` is on the run's clock.
    ///
    /// # Errors
    /// When it is about a tick that is not remembered.
    pub fn date(&self, advice: &mut Advice, now: Instant) -> Result<(), Reason> {
        let Advice { header, .. } = *advice;
        let of_episode = |driven: &Driven| driven.episode == header.episode;
        let read = self.find(|driven| of_episode(driven) && driven.step.0 == header.tick);
        advice.header.taken_ns = read.ok_or(Reason::Undated)?.step.1;
        let has_answer = advice.holds_until_ns > 0;
        if has_answer {
            let tick = advice.question_tick;
            let asked = self.find(|driven| of_episode(driven) && driven.observation.0 == tick);
            let taken_ns = asked.ok_or(Reason::Undated)?.observation.1;
            advice.question_taken_ns = taken_ns;
            advice.holds_until_ns = taken_ns.saturating_add(self.hold_ns);
        } else {
            advice.question_taken_ns = 0;
        }
        let within = |at_ns: u64| at_ns.clamp(advice.question_taken_ns.min(now.0), now.0);
        advice.answered_ns = match has_answer {
            true => within(advice.answered_ns),
            false => 0,
        };
        advice.considered_ns = within(advice.considered_ns);
        // A label has no tick, only the instant of its question, which is this machine's.
        if advice.label_from_ns > 0 || advice.label_until_ns > 0 {
            let from_ns = advice.label_from_ns;
            self.find(|driven| driven.observation.1 == from_ns)
                .ok_or(Reason::Undated)?;
            advice.label_until_ns = from_ns.saturating_add(self.label_ns);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 100_000_000;
    const START_NS: u64 = 5_000_000_000;

    fn driven(ticks: u64) -> Dating {
        let mut dating = Dating::new(&Gate::default());
        for tick in 1..=ticks {
            let mut step = Step::default();
            step.header.tick = tick;
            step.header.episode = 2;
            step.header.taken_ns = START_NS + tick * PERIOD_NS + 1_000;
            step.observation.header.tick = tick;
            step.observation.header.taken_ns = START_NS + tick * PERIOD_NS;
            dating.note(&step);
        }
        dating
    }

    fn advice() -> Advice {
        let mut advice = Advice {
            question_tick: 15,
            // The clock of a judge that is an hour off.
            question_taken_ns: 3_600_000_000_000,
            answered_ns: 3_600_100_000_000,
            considered_ns: 3_600_100_000_000,
            holds_until_ns: 3_610_000_000_000,
            answers: 1,
            ..Advice::default()
        };
        (advice.header.tick, advice.header.episode) = (20, 2);
        advice
    }

    #[test]
    fn advice_gets_the_times_of_the_ticks_that_it_is_about() {
        let dating = driven(20);
        let now = Instant(START_NS + 21 * PERIOD_NS);
        let mut advice = advice();
        assert_eq!(dating.date(&mut advice, now), Ok(()));
        let asked_ns = START_NS + 15 * PERIOD_NS;
        assert_eq!(advice.question_taken_ns, asked_ns);
        assert_eq!(
            advice.holds_until_ns,
            asked_ns + (Gate::default().hold_s * 1e9) as u64
        );
        assert_eq!(advice.header.taken_ns, START_NS + 20 * PERIOD_NS + 1_000);
        assert_eq!((advice.answered_ns, advice.considered_ns), (now.0, now.0));
    }

    #[test]
    fn advice_about_ticks_that_were_not_driven_is_refused() {
        let dating = driven(20);
        let now = Instant(START_NS + 21 * PERIOD_NS);
        for change in [
            |advice: &mut Advice| advice.header.tick = 21,
            |advice: &mut Advice| advice.header.episode = 1,
            |advice: &mut Advice| advice.question_tick = 900,
            |advice: &mut Advice| advice.label_from_ns = START_NS + 1,
        ] {
            let mut wrong = advice();
            change(&mut wrong);
            assert_eq!(
                dating.date(&mut wrong, now),
                Err(Reason::Undated),
                "{wrong:?}"
            );
        }
    }

    #[test]
    fn advice_without_an_answer_needs_no_question() {
        let dating = driven(3);
        let mut advice = Advice::default();
        (advice.header.tick, advice.header.episode) = (3, 2);
        assert_eq!(dating.date(&mut advice, Instant(START_NS * 2)), Ok(()));
        assert_eq!((advice.question_taken_ns, advice.answered_ns), (0, 0));
    }
}
