use std::time::Duration;

/// A circuit breaker: it stops requests to a server that failed repeatedly, and tries
/// one request after a while. It is arithmetic; instants are times since any fixed
/// moment.
#[derive(Debug, Clone)]
pub struct Breaker {
    failures_max: u32,
    open_for: Duration,
    state: State,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// Closed: requests pass. Holds the number of failures in a row.
    Closed { failures: u32 },
    /// Open: no request passes until this instant.
    Open { until: Duration },
    /// Half open: one request has passed to try the server. Another may pass after this
    /// instant, because the first may never report its result.
    HalfOpen { until: Duration },
}

impl Breaker {
    /// Opens after `failures_max` failures in a row, for `open_for`.
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

    /// Lets a request pass if it may. Only one request at a time tries the server.
    pub fn admit(&mut self, now: Duration) -> bool {
        let passes = !self.is_open(now);
        if passes && !matches!(self.state, State::Closed { .. }) {
            self.state = State::HalfOpen {
                until: now + self.open_for,
            };
        }
        passes
    }

    /// A request reached the server, with any status.
    pub fn succeeded(&mut self) {
        self.state = State::Closed { failures: 0 };
    }

    /// No attempt of a question reached the server.
    pub fn failed(&mut self, now: Duration) {
        let failures = match self.state {
            State::Closed { failures } => failures + 1,
            // A request from before the breaker opened says nothing new.
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
    fn it_opens_after_failures_in_a_row_for_the_configured_time() {
        let mut breaker = opened();
        assert!(!breaker.admit(S(2)));
        assert!(!breaker.admit(S(31)));
        assert!(breaker.admit(S(32)), "30 s after the last");
    }

    #[test]
    fn a_success_resets_the_count_of_failures() {
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
    fn one_trial_request_closes_or_opens_it_again() {
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
    fn an_abandoned_trial_does_not_block_the_next_one() {
        let mut breaker = opened();
        assert!(breaker.admit(S(40)));
        assert!(!breaker.admit(S(69)));
        assert!(breaker.admit(S(70)));
    }

    #[test]
    fn late_failures_of_earlier_questions_change_nothing() {
        let mut breaker = opened();
        breaker.failed(S(20));
        assert!(breaker.admit(S(32)), "not put off");
    }
}
