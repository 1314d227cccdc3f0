//! The limits of a run: requests per minute, and money. They are arithmetic; instants
//! are times since any fixed moment.

use std::collections::VecDeque;
use std::time::Duration;

/// Limits the requests in any 60 s.
#[derive(Debug, Clone)]
pub struct Rate {
    // When the last requests were made; never more entries than the limit.
    made: VecDeque<Duration>,
    per_minute_max: usize,
}

const MINUTE: Duration = Duration::from_secs(60);

impl Rate {
    /// A limit of at least 1 request.
    pub fn new(per_minute_max: u32) -> Self {
        let per_minute_max = per_minute_max.max(1) as usize;
        Self {
            made: VecDeque::with_capacity(per_minute_max),
            per_minute_max,
        }
    }

    /// Counts a request, or returns how long it must wait.
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

/// The money that a run may spend.
#[derive(Debug, Clone)]
pub struct Budget {
    limit_usd: f64,
    spent_usd: f64,
}

impl Budget {
    /// A budget of which nothing is spent.
    pub fn new(limit_usd: f64) -> Self {
        Self {
            limit_usd,
            spent_usd: 0.0,
        }
    }

    /// Reserves the cost before a request is made; `false` if it exceeds the rest. A
    /// reservation that is never settled stays spent, because the real cost is unknown.
    #[must_use]
    pub fn reserve(&mut self, cost_usd: f64) -> bool {
        let fits = self.spent_usd + cost_usd <= self.limit_usd;
        if fits {
            self.spent_usd += cost_usd;
        }
        fits
    }

    /// Replaces a reservation by the real cost of the request.
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
    fn a_request_passes_after_the_returned_wait() {
        let mut rate = Rate::new(2);
        assert_eq!(rate.admit(Duration::from_secs(1)), Ok(()));
        assert_eq!(rate.admit(Duration::from_secs(5)), Ok(()));
        let wait = rate.admit(Duration::from_secs(11));
        assert_eq!(wait, Err(Duration::from_secs(50)));
        assert_eq!(rate.admit(Duration::from_secs(61)), Ok(()));
    }

    #[test]
    fn reservations_never_exceed_the_budget() {
        let mut budget = Budget::new(0.10);
        let asked = (0..1000).filter(|_| budget.reserve(0.03)).count();
        assert_eq!(asked, 3);
        budget.settle(0.03, 0.01);
        assert!((budget.spent_usd() - 0.07).abs() < 1e-12);
        assert!(budget.reserve(0.03));
        assert!(!budget.reserve(0.03));
    }

    #[test]
    fn an_empty_budget_admits_only_free_requests() {
        let mut budget = Budget::new(0.0);
        assert!(budget.reserve(0.0));
        assert!(!budget.reserve(1e-9));
    }
}
