//! Whose turn it is when the planner is slower than the controller.

use crate::message::Header;

/// The ticks on which the planner plans: one in every so many, and the first of
/// an episode, whose car has no plan yet.
///
/// Planner and controller ask it alike, each for itself, so that the controller
/// waits for a plan exactly where one is made. A tick that was missed is made up
/// for at the next one seen.
#[derive(Debug, Clone)]
pub struct PlanTurns {
    ticks: u64,
    last: Option<(u32, u64)>,
}

impl PlanTurns {
    /// A turn in every `ticks` ticks of the run.
    pub fn every(ticks: u64) -> Self {
        Self {
            ticks: ticks.max(1),
            last: None,
        }
    }

    /// Whether the planner's turn is at the tick of this observation; each turn
    /// is taken once.
    pub fn take(&mut self, header: &Header) -> bool {
        let turn = Some((header.episode, header.tick / self.ticks));
        let is_new = turn != self.last;
        self.last = turn;
        is_new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(turns: &mut PlanTurns, episode: u32, ticks: impl Iterator<Item = u64>) -> Vec<u64> {
        let header = |tick| Header {
            tick,
            episode,
            ..Header::default()
        };
        ticks.filter(|&tick| turns.take(&header(tick))).collect()
    }

    #[test]
    fn every_tick_is_a_turn_at_equal_rates() {
        let mut turns = PlanTurns::every(1);
        assert_eq!(taken(&mut turns, 0, 0..4), [0, 1, 2, 3]);
        assert_eq!(taken(&mut turns, 0, [3, 3].into_iter()), [], "once each");
    }

    #[test]
    fn a_slower_planner_has_every_so_many_and_the_first_of_an_episode() {
        let mut turns = PlanTurns::every(5);
        assert_eq!(taken(&mut turns, 0, 0..13), [0, 5, 10]);
        assert_eq!(taken(&mut turns, 1, 13..22), [13, 15, 20]);
    }

    #[test]
    fn a_missed_turn_is_made_up_for_and_a_restarted_world_begins_anew() {
        let mut turns = PlanTurns::every(5);
        assert_eq!(taken(&mut turns, 0, [4, 7, 8, 21].into_iter()), [4, 7, 21]);
        assert_eq!(taken(&mut turns, 0, [0, 1].into_iter()), [0]);
    }
}
