//! The instants at which the world moves and is observed: which of them are
//! ticks of the run, and which sub-steps of the physics are due.

use shm_config::Instant;
use shm_config::config::{Config, PHYSICS_HZ};

use crate::dynamics::SUBSTEPS;

/// The world's grid. One in every so many of its instants is a tick of the run,
/// which the controller answers.
#[derive(Clone, Debug)]
pub struct Grid {
    /// From tick to tick of the run.
    period_ns: u64,
    /// Instants in a tick of the run.
    share: u64,
    /// Instants in a tick of the physics.
    hold: u64,
    first: Instant,
    /// The instant that comes next, or is now.
    index: u64,
    missed: u64,
    /// Sub-steps that were due so far.
    moved: u64,
}

impl Grid {
    /// A grid with its first instant there.
    pub fn new(config: &Config, first: Instant) -> Grid {
        Grid {
            period_ns: config.run.period_ns(),
            share: config.world_instants(),
            hold: (config.world_rate_hz() / PHYSICS_HZ).round() as u64,
            first,
            index: 0,
            missed: 0,
            moved: 0,
        }
    }

    /// When the instant that is next, or now, is due.
    pub fn now(&self) -> Instant {
        // Ticks of the run fall on whole periods, whatever the share.
        self.first
            .after_ns(self.index * self.period_ns / self.share)
    }

    /// When the instant before that one was due.
    pub fn previous(&self) -> Instant {
        Instant(self.now().0.saturating_sub(self.step_ns()))
    }

    /// From instant to instant; a nanosecond more where the share is uneven.
    pub fn step_ns(&self) -> u64 {
        self.period_ns / self.share
    }

    /// Nothing has moved yet.
    pub fn is_first(&self) -> bool {
        self.index == 0
    }

    /// The run's tick of now.
    pub fn tick(&self) -> u64 {
        self.index / self.share
    }

    /// Ticks of the run that were due before now.
    pub fn ticks_due(&self) -> u64 {
        self.index.div_ceil(self.share)
    }

    /// When a tick of the run is due.
    pub fn tick_instant(&self, tick: u64) -> Instant {
        self.first.after_ns(tick * self.period_ns)
    }

    /// Instants missed.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// The instant of now is done.
    pub fn move_on(&mut self) {
        self.index += 1;
    }

    /// It is this late: the newest instant that was due is now, those before it
    /// are missed.
    pub fn miss_until(&mut self, now: Instant) {
        let passed = now.since_ns(self.now()) * self.share / self.period_ns;
        self.index += passed;
        self.missed += passed;
    }

    /// Sub-steps of the physics to make now; each is due once. Those of whole
    /// ticks that were slept through are lost, so that at most one tick is made
    /// up for.
    pub fn take_substeps(&mut self) -> u64 {
        let tick = u64::from(SUBSTEPS);
        let due = self.index * tick / self.hold;
        let passed = due - self.moved;
        self.moved = due;
        match passed {
            0 => 0,
            passed => (passed - 1) % tick + 1,
        }
    }

    /// Share of the next sub-step that has passed, [0, 1).
    pub fn substep_share(&self) -> f64 {
        (self.index * u64::from(SUBSTEPS) % self.hold) as f64 / self.hold as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FIRST: Instant = Instant(5_000_000_000);

    fn grid(world_hz: f64, run_hz: f64) -> Grid {
        let mut config = Config::default();
        config.world.rate_hz = world_hz;
        config.run.rate_hz = run_hz;
        Grid::new(&config, FIRST)
    }

    /// Sub-steps at each instant of a tick of the physics, from the second on.
    fn substeps(grid: &mut Grid, count: usize) -> Vec<u64> {
        let step = |_| {
            grid.move_on();
            grid.take_substeps()
        };
        (0..count).map(step).collect()
    }

    #[test]
    fn at_10_hz_every_instant_is_a_tick_with_five_substeps() {
        let mut grid = grid(0.0, 10.0);
        assert_eq!(substeps(&mut grid, 3), [5, 5, 5]);
        assert_eq!((grid.tick(), grid.ticks_due()), (3, 3));
        assert_eq!(grid.substep_share(), 0.0);
        assert_eq!(grid.now(), FIRST.after_ns(300_000_000));
    }

    #[test]
    fn a_tick_of_the_physics_has_five_substeps_at_any_rate() {
        for world_hz in [10.0, 20.0, 30.0, 50.0, 70.0, 100.0, 990.0, 1000.0] {
            let mut grid = grid(world_hz, 10.0);
            let count = (world_hz / 10.0) as usize;
            for _ in 0..20 {
                let made: u64 = substeps(&mut grid, count).iter().sum();
                assert_eq!(made, 5, "{world_hz} Hz");
                assert_eq!(grid.substep_share(), 0.0);
            }
            assert_eq!(grid.now(), FIRST.after_ns(2_000_000_000), "{world_hz} Hz");
        }
    }

    #[test]
    fn between_substeps_a_share_has_passed() {
        let mut grid = grid(100.0, 50.0);
        assert_eq!(substeps(&mut grid, 3), [0, 1, 0]);
        assert_eq!(grid.substep_share(), 0.5);
        assert_eq!((grid.tick(), grid.ticks_due()), (1, 2));
        assert_eq!(grid.tick_instant(2), FIRST.after_ns(40_000_000));
        assert_eq!(grid.now().since_ns(grid.previous()), grid.step_ns());
        assert_eq!(grid.step_ns(), 10_000_000);
    }

    #[test]
    fn what_was_slept_through_is_missed_and_at_most_one_tick_is_made_up_for() {
        let mut grid = grid(100.0, 50.0);
        grid.miss_until(FIRST.after_ns(9_999_999));
        assert_eq!(grid.missed(), 0);
        // 30 ms: one sub-step; 340 ms: of sixteen more, three ticks are lost.
        grid.miss_until(FIRST.after_ns(30_000_000));
        assert_eq!((grid.missed(), grid.take_substeps()), (3, 1));
        grid.miss_until(FIRST.after_ns(340_000_000));
        assert_eq!((grid.missed(), grid.take_substeps()), (34, 1));
        assert_eq!((grid.tick(), grid.ticks_due()), (17, 17));
    }
}
