//! What may be asked at all: so many requests a minute, for so much money.
//! Arithmetic: instants are times since any one moment.

use std::collections::VecDeque;
use std::time::Duration;

/// At most so many requests in any 60 s.
#[derive(Debug, Clone)]
pub struct Rate {
    // When the last requests were made; never more than the limit.
    made: VecDeque<Duration>,
    per_minute_max: usize,
}

const MINUTE: Duration = Duration::from_secs(60);

impl Rate {
    /// A limit of at least 1.
    pub fn new(per_minute_max: u32) -> Self {
        let per_minute_max = per_minute_max.max(1) as usize;
        Self {
            made: VecDeque::with_capacity(per_minute_max),
            per_minute_max,
        }
    }

    /// Counts a request, or says how long it would have to wait.
    ///
    /// # Errors
    /// The time until one may be made.
    pub fn admit(&mut self, now: Duration) -> Result<(), Duration> {
        if self.made.len() == self.per_minute_max {
            let free = self.made[0] + MINUTE;
            if now < free {
                return Err(free - now);
            }
            self.made.pop_front();
        }
        self.made.push_back(now);
        Ok(())
    }
}

/// What a run may cost.
#[derive(Debug, Clone)]
pub struct Budget {
    limit_usd: f64,
    spent_usd: f64,
}

impl Budget {
    /// Nothing spent yet.
    pub fn new(limit_usd: f64) -> Self {
        Self {
            limit_usd,
            spent_usd: 0.0,
        }
    }

    /// Sets the cost aside before a request is made; `false` when it is more than
    /// what is left. What is never settled stays spent: nobody knows better.
    #[must_use]
    pub fn reserve(&mut self, cost_usd: f64) -> bool {
        let fits = self.spent_usd + cost_usd <= self.limit_usd;
        if fits {
            self.spent_usd += cost_usd;
        }
        fits
    }

    /// Puts what a request did cost in the place of what was set aside.
    pub fn settle(&mut self, reserved_usd: f64, cost_usd: f64) {
        self.spent_usd = (self.spent_usd - reserved_usd + cost_usd).max(0.0);
    }

    /// Spent and set aside, US dollars.
    pub fn spent_usd(&self) -> f64 {
        self.spent_usd
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_minute_has_more_requests_than_allowed() {
        for per_minute in [1, 7, 60] {
            let mut rate = Rate::new(per_minute);
            let mut made = Vec::new();
            // Bursts and pauses, 10 minutes of them.
            for tick in 0..6000_u64 {
                let now = Duration::from_millis(100 * tick);
                if tick / 137 % 3 != 1 && rate.admit(now).is_ok() {
                    made.push(now);
                }
            }
            let within = |at: &Duration| {
                let window = *at..*at + MINUTE;
                made.iter().filter(|&other| window.contains(other)).count()
            };
            let most = made.iter().map(within).max().expect("requests");
            assert_eq!(most, per_minute as usize, "reached, never passed");
        }
    }

    #[test]
    fn the_wait_is_as_long_as_it_says() {
        let mut rate = Rate::new(2);
        assert_eq!(rate.admit(Duration::from_secs(1)), Ok(()));
        assert_eq!(rate.admit(Duration::from_secs(5)), Ok(()));
        let wait = rate.admit(Duration::from_secs(11));
        assert_eq!(wait, Err(Duration::from_secs(50)));
        assert_eq!(rate.admit(Duration::from_secs(61)), Ok(()));
    }

    #[test]
    fn a_budget_is_never_overdrawn_by_what_was_foreseen() {
        let mut budget = Budget::new(0.10);
        let asked = (0..1000).filter(|_| budget.reserve(0.03)).count();
        assert_eq!(asked, 3);
        budget.settle(0.03, 0.01);
        assert!((budget.spent_usd() - 0.07).abs() < 1e-12);
        assert!(budget.reserve(0.03));
        assert!(!budget.reserve(0.03));
    }

    #[test]
    fn nothing_may_be_spent_and_free_is_free() {
        let mut budget = Budget::new(0.0);
        assert!(budget.reserve(0.0));
        assert!(!budget.reserve(1e-9));
    }
}
