//! Which run needs attention: a pure function of what its reader has found and of the time.

use serde::Serialize;
use shm_config::Instant;

/// Time without a step after which a run is silent, ns. A reader looks every 250 ms and
/// the cards are published every 500 ms, so that silence is shown within 2 s.
pub const SILENT_NS: u64 = 1_000_000_000;
/// The same for a slow run, in periods of its controller.
const SILENT_PERIODS: u64 = 3;
/// Time that a run has for its first step, ns: a mirror waits for its vehicle, a set for
/// its processes.
const START_NS: u64 = 5_000_000_000;
/// Time for which a run that cannot be opened may just be starting or ending, ns.
const OPEN_NS: u64 = 3_000_000_000;
/// Time for which a fault asks for attention, ns.
pub const FAULT_NS: u64 = 30_000_000_000;
/// Time for which a skipped tick asks for attention, ns.
pub const RISING_NS: u64 = 10_000_000_000;

/// The state of a run on the page, the most urgent first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// It lives and publishes no step.
    Silent,
    /// It lives and cannot be opened.
    Refused,
    /// A fault, or a restarted process, a moment ago.
    Faulty,
    /// Ticks were skipped a moment ago.
    Skipping,
    /// It drives.
    Live,
    /// No step yet.
    Starting,
    /// Its supervisor has ended.
    Ended,
}

/// What a reader has found of a run; instants are on the machine's clock.
#[derive(Debug, Clone, Default)]
pub struct Facts {
    /// When the run was found, or its reader opened it.
    pub opened: Instant,
    /// When the newest step was read.
    pub newest: Option<Instant>,
    /// When the last fault was read.
    pub fault: Option<Instant>,
    /// When skipped ticks were last seen to rise.
    pub rising: Option<Instant>,
    /// When its end was seen.
    pub end: Option<Instant>,
    /// Why it cannot be opened, and since when.
    pub refusal: Option<(Instant, String)>,
    /// Period of its controller, ns.
    pub period_ns: u64,
}

impl Facts {
    /// The state at this time.
    pub fn state(&self, now: Instant) -> State {
        let within = |at: Option<Instant>, ns| at.is_some_and(|at| now.since_ns(at) <= ns);
        if self.end.is_some() {
            return State::Ended;
        }
        if let Some((since, _)) = &self.refusal {
            return match now.since_ns(*since) <= OPEN_NS {
                true => State::Starting,
                false => State::Refused,
            };
        }
        let Some(newest) = self.newest else {
            return match now.since_ns(self.opened) <= START_NS {
                true => State::Starting,
                false => State::Silent,
            };
        };
        let silent_ns = SILENT_NS.max(self.period_ns.saturating_mul(SILENT_PERIODS));
        match now.since_ns(newest) {
            age_ns if age_ns > silent_ns => State::Silent,
            _ if within(self.fault, FAULT_NS) => State::Faulty,
            _ if within(self.rising, RISING_NS) => State::Skipping,
            _ => State::Live,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn at(seconds: u64) -> Instant {
        Instant(seconds * SECOND)
    }

    fn driving() -> Facts {
        Facts {
            opened: at(100),
            newest: Some(at(200)),
            period_ns: 100_000_000,
            ..Facts::default()
        }
    }

    #[test]
    fn a_run_without_steps_is_silent_after_a_second_or_three_of_its_periods() {
        let mut facts = driving();
        assert_eq!(facts.state(at(201)), State::Live);
        assert_eq!(facts.state(at(202)), State::Silent);
        facts.period_ns = SECOND;
        assert_eq!(facts.state(at(203)), State::Live);
        assert_eq!(facts.state(at(204)), State::Silent);
    }

    #[test]
    fn faults_and_skipped_ticks_ask_for_attention_for_a_while() {
        let mut facts = driving();
        (facts.fault, facts.rising) = (Some(at(180)), Some(at(195)));
        assert_eq!(facts.state(at(200)), State::Faulty);
        facts.newest = Some(at(205));
        facts.fault = Some(at(174));
        assert_eq!(facts.state(at(205)), State::Skipping);
        facts.newest = Some(at(206));
        assert_eq!(facts.state(at(206)), State::Live);
        assert_eq!(facts.state(at(220)), State::Silent, "silence says more");
    }

    #[test]
    fn a_run_that_starts_is_not_silent_and_one_that_cannot_be_opened_says_so() {
        let mut facts = Facts {
            opened: at(10),
            ..Facts::default()
        };
        assert_eq!(facts.state(at(15)), State::Starting);
        assert_eq!(facts.state(at(16)), State::Silent);
        facts.refusal = Some((at(20), "another layout".into()));
        assert_eq!(facts.state(at(23)), State::Starting);
        assert_eq!(facts.state(at(24)), State::Refused);
        facts.end = Some(at(24));
        assert_eq!(facts.state(at(24)), State::Ended);
    }

    #[test]
    fn the_most_urgent_state_is_the_least() {
        let mut states = [
            State::Ended,
            State::Live,
            State::Skipping,
            State::Starting,
            State::Faulty,
            State::Silent,
            State::Refused,
        ];
        states.sort();
        let words = serde_json::to_value(states).expect("JSON");
        let expected = serde_json::json!([
            "silent", "refused", "faulty", "skipping", "live", "starting", "ended"
        ]);
        assert_eq!(words, expected);
    }
}
