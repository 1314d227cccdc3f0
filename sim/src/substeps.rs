//! Which sub-steps of the physics are due at an instant of the world.

use crate::dynamics::SUBSTEPS;

/// Counts the sub-steps that were made.
#[derive(Clone, Debug)]
pub struct Substeps {
    /// Instants of the world in one tick of the traffic's decisions.
    hold: u64,
    /// Sub-steps that were due so far.
    moved: u64,
}

impl Substeps {
    /// Of a world with so many instants in one tick of the traffic's decisions.
    pub fn new(hold: u64) -> Substeps {
        Substeps { hold, moved: 0 }
    }

    /// Sub-steps to make at this instant, counted from the first; each is due once.
    /// Sub-steps of whole ticks that were missed are dropped, so that at most one tick
    /// is made up for.
    pub fn take(&mut self, index: u64) -> u64 {
        let tick = u64::from(SUBSTEPS);
        let due = index * tick / self.hold;
        let passed = due - self.moved;
        self.moved = due;
        match passed {
            0 => 0,
            passed => (passed - 1) % tick + 1,
        }
    }

    /// Share of the next sub-step that has passed at that instant, [0, 1).
    pub fn share(&self, index: u64) -> f64 {
        (index * u64::from(SUBSTEPS) % self.hold) as f64 / self.hold as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_of_the_decisions_has_five_substeps_at_any_rate() {
        for hold in [1, 2, 3, 5, 7, 10, 99, 100] {
            let mut substeps = Substeps::new(hold);
            for tick in 0..20 {
                let made: u64 = (1..=hold)
                    .map(|part| substeps.take(tick * hold + part))
                    .sum();
                assert_eq!(made, 5, "{hold}");
                assert_eq!(substeps.share((tick + 1) * hold), 0.0);
            }
        }
    }

    #[test]
    fn between_substeps_a_share_has_passed() {
        let mut substeps = Substeps::new(10);
        assert_eq!([1, 2, 3].map(|index| substeps.take(index)), [0, 1, 0]);
        assert_eq!(substeps.share(3), 0.5);
    }

    #[test]
    fn at_most_one_tick_is_made_up_for() {
        let mut substeps = Substeps::new(10);
        assert_eq!(substeps.take(3), 1);
        // Of sixteen more, three ticks are lost.
        assert_eq!(substeps.take(34), 1);
    }
}
