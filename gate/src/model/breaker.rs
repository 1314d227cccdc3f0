use std::time::Duration;

/// Leaves a server alone that broke down again and again, and tries it with one
/// request after a while. Arithmetic: instants are times since any one moment.
#[derive(Debug, Clone)]
pub struct Breaker {
    failures_max: u32,
    open_for: Duration,
    state: State,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Questions pass; so many breakdowns in a row so far.
    Closed { failures: u32 },
    /// No question passes until then.
    Open { until: Duration },
    /// One question has passed to try the server. Another may after that
    /// instant: the one that tries may have been given up without a word.
    HalfOpen { until: Duration },
}

impl Breaker {
    /// Opens after `failures_max` breakdowns in a row, for `open_for`.
    pub fn new(failures_max: u32, open_for: Duration) -> Self {
        Self {
            failures_max,
            open_for,
            state: State::Closed { failures: 0 },
        }
    }

    /// No request may pass now.
    pub fn is_open(&self, now: Duration) -> bool {
        match self.state {
            State::Closed { .. } => false,
            State::Open { until } | State::HalfOpen { until } => now < until,
        }
    }

    /// Lets a request pass, if one may: the one that tries the server is alone.
    pub fn admit(&mut self, now: Duration) -> bool {
        let passes = !self.is_open(now);
        if passes && !matches!(self.state, State::Closed { .. }) {
            self.state = State::HalfOpen {
                until: now + self.open_for,
            };
        }
        passes
    }

    /// The server was there, whatever it said.
    pub fn succeeded(&mut self) {
        self.state = State::Closed { failures: 0 };
    }

    /// The server was not there, in no attempt of a question.
    pub fn failed(&mut self, now: Duration) {
        let failures = match self.state {
            State::Closed { failures } => failures + 1,
            // What was asked before it opened says nothing new.
            State::Open { .. } => return,
            State::HalfOpen { .. } => self.failures_max,
        };
        self.state = match failures >= self.failures_max {
            true => State::Open {
                until: now + self.open_for,
            },
            false => State::Closed { failures },
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: fn(u64) -> Duration = Duration::from_secs;

    fn opened() -> Breaker {
        let mut breaker = Breaker::new(3, S(30));
        for second in 0..3 {
            assert!(breaker.admit(S(second)));
            breaker.failed(S(second));
        }
        breaker
    }

    #[test]
    fn it_opens_after_breakdowns_in_a_row_and_for_its_time() {
        let mut breaker = opened();
        assert!(!breaker.admit(S(2)));
        assert!(!breaker.admit(S(31)));
        assert!(breaker.admit(S(32)), "30 s after the last");
    }

    #[test]
    fn a_success_between_them_begins_the_row_again() {
        let mut breaker = Breaker::new(3, S(30));
        for second in 0..20 {
            assert!(breaker.admit(S(second)), "second {second}");
            match second % 3 {
                2 => breaker.succeeded(),
                _ => breaker.failed(S(second)),
            }
        }
    }

    #[test]
    fn one_question_tries_and_decides() {
        let mut breaker = opened();
        assert!(breaker.admit(S(40)));
        assert!(!breaker.admit(S(40)), "one alone");
        breaker.failed(S(41));
        assert!(!breaker.admit(S(70)), "open again, from the trial on");
        assert!(breaker.admit(S(71)));
        breaker.succeeded();
        assert!(breaker.admit(S(71)) && breaker.admit(S(71)));
    }

    #[test]
    fn a_trial_that_was_given_up_does_not_close_it_for_ever() {
        let mut breaker = opened();
        assert!(breaker.admit(S(40)));
        assert!(!breaker.admit(S(69)));
        assert!(breaker.admit(S(70)));
    }

    #[test]
    fn late_news_of_earlier_questions_changes_nothing() {
        let mut breaker = opened();
        breaker.failed(S(20));
        assert!(breaker.admit(S(32)), "not put off");
    }
}
