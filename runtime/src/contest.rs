use shm_config::Instant;
use shm_config::wire::Wire;

/// How long the car is braked after the last message of a process that sends in the
/// place of one that the run has started, ns: at the slowest rate of a sender that a
/// loop at 10 Hz notices, several messages come in that time, so that the brake holds
/// between them.
const HOLD_NS: u64 = 1_000_000_000;

/// Whether two living processes send one state: then nothing that is received can be
/// trusted to be the run's own, and the car is braked.
#[derive(Debug, Clone, Default)]
pub struct Contest {
    seen: u64,
    until: Option<Instant>,
}

impl Contest {
    /// Looks at what the ports refused, after they were read at `now`; whether the car
    /// is to be braked.
    pub fn look(&mut self, wire: &Wire, now: Instant) -> bool {
        self.count(wire.contests(), now)
    }

    fn count(&mut self, contests: u64, now: Instant) -> bool {
        if contests != self.seen {
            self.seen = contests;
            self.until = Some(now.after_ns(HOLD_NS));
        }
        self.until.is_some_and(|until| now < until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_brake_holds_while_foreign_messages_come_and_a_second_longer() {
        let mut contest = Contest::default();
        assert!(!contest.count(0, Instant(5)));
        assert!(contest.count(1, Instant(10)));
        assert!(contest.count(1, Instant(10 + HOLD_NS - 1)));
        assert!(contest.count(2, Instant(10 + HOLD_NS)), "another one came");
        assert!(!contest.count(2, Instant(10 + 2 * HOLD_NS)));
    }
}
