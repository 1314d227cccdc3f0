use shm_config::Instant;
use shm_config::wire::Wire;

/// How long the car is braked after the last message of a foreign process that sends in
/// place of a process of the run, ns. Even the slowest sender that a loop at 10 Hz
/// notices sends several messages in this time, so the brake holds between them.
const HOLD_NS: u64 = 1_000_000_000;

/// Detects that two living processes send the same state. Then no received message can
/// be trusted to be the run's own, and the car is braked.
#[derive(Debug, Clone, Default)]
pub struct Contest {
    seen: u64,
    until: Option<Instant>,
}

impl Contest {
    /// Reads the refusals that the ports counted; call it after they were read at
    /// `now`. Returns whether the car must brake.
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
