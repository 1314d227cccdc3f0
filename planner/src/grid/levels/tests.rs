//! The levels against the rows themselves.

use proptest::prelude::*;
use shm_config::message::Observation;
use vehicle::Point;

use crate::{Grid, PlannerConfig};

/// Some returns of a scanner with 64 beams on a road.
fn scene(returns: &[(usize, f32)], [left_m, right_m]: [f64; 2]) -> Observation {
    let mut observation = Observation {
        beam_count: 64,
        lidar_max_m: 50.0,
        ..Observation::default()
    };
    observation.ranges_m.fill(50.0);
    for (beam, range_m) in returns {
        observation.ranges_m[*beam] = *range_m;
    }
    (observation.road.left_m, observation.road.right_m) = (left_m, right_m);
    observation
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

    /// Lines of all lengths, also out of the corridor, beyond the levels and out of the grid.
    #[test]
    fn the_same_lines_are_free_with_levels_and_without(
        returns in prop::collection::vec((0usize..64, 0.5f32..20.0), 0..20),
        edges_m in [0.5..9.0, 0.5..9.0],
        level_m in 0.0..40.0,
        lines in prop::collection::vec(
            (0.0..31.0, -11.0..11.0, prop_oneof![-0.3..0.3, -3.0..3.0, -20.0..20.0],
             prop_oneof![-0.3..0.3, -3.0..3.0, -20.0..20.0]),
            100,
        ),
    ) {
        let mut grid = Grid::new(&PlannerConfig::default());
        grid.fill(&scene(&returns, edges_m));
        let lines: Vec<[Point; 2]> = lines
            .into_iter()
            .map(|(x, y, dx, dy)| [Point::new(x, y), Point::new(x + dx, y + dy)])
            .collect();
        let free = |grid: &Grid| -> Vec<bool> {
            lines.iter().map(|[from, to]| grid.is_segment_free(*from, *to)).collect()
        };
        let without = free(&grid);
        grid.level(level_m);
        prop_assert_eq!(&free(&grid), &without);
        // A grid that is filled again has none of the levels before.
        grid.fill(&scene(&[], edges_m));
        let empty = free(&grid);
        let mut fresh = Grid::new(&PlannerConfig::default());
        fresh.fill(&scene(&[], edges_m));
        prop_assert_eq!(empty, free(&fresh));
    }
}
