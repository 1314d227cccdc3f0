//! The ticks at which the planner plans when it is slower than the controller.

use crate::message::Header;

/// The ticks at which the planner plans: one of every `ticks`, and the first of an
/// episode, when the car has no plan yet.
///
/// Planner and controller each keep one of these and get the same answers, so the
/// controller waits for a plan exactly where one is made. A missed tick is made up for
/// at the next observed one.
#[derive(Debug, Clone)]
pub struct PlanTurns {
    ticks: u64,
    last: Option<(u32, u64)>,
}

impl PlanTurns {
    /// One planning tick in every `ticks` ticks of the run.
    pub fn every(ticks: u64) -> Self {
        Self {
            ticks: ticks.max(1),
            last: None,
        }
    }

    /// Whether the planner plans at the tick of this observation; each planning tick is
    /// returned once.
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
