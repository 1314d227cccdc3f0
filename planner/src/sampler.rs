use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rand_xoshiro::{SplitMix64, Xoshiro256PlusPlus};
use shm_config::message::Header;
use vehicle::Point;

use crate::grid::Grid;

/// The rectangle of the body frame that samples are drawn from: from the origin
/// to the goal along x, the corridor along y.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Region {
    pub(crate) x_max_m: f64,
    pub(crate) right_m: f64,
    pub(crate) left_m: f64,
}

impl Region {
    /// Of the plans to a goal on a grid.
    pub(crate) fn before(goal_body: Point, grid: &Grid) -> Self {
        let corridor = grid.corridor();
        Self {
            x_max_m: goal_body.x.clamp(0.0, grid.x_max_m()),
            right_m: corridor.right_m,
            left_m: corridor.left_m,
        }
    }
}

/// The random numbers of one plan.
pub(crate) struct Sampler {
    stream: Xoshiro256PlusPlus,
}

impl Sampler {
    /// The stream that belongs to one tick of one episode.
    ///
    /// Each number goes through a full SplitMix64 step before the next is mixed
    /// in, so that neighbouring ticks, episodes and seeds share nothing. No
    /// state lives from plan to plan: a restarted planner draws the same.
    pub(crate) fn new(seed: u64, header: &Header) -> Self {
        let mixed = [u64::from(header.episode), header.tick]
            .into_iter()
            .fold(spread(seed), |mixed, number| spread(mixed ^ number));
        Self {
            stream: Xoshiro256PlusPlus::seed_from_u64(mixed),
        }
    }

    /// Uniform in [0, 1): the 53 upper bits.
    pub(crate) fn unit(&mut self) -> f64 {
        (self.stream.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in the region; two numbers of the stream, x first.
    pub(crate) fn point_body(&mut self, region: &Region) -> Point {
        let x_m = self.unit() * region.x_max_m;
        let y_m = region.right_m + self.unit() * (region.left_m - region.right_m);
        Point::new(x_m, y_m)
    }
}

/// One SplitMix64 step.
fn spread(number: u64) -> u64 {
    SplitMix64::seed_from_u64(number).next_u64()
}
