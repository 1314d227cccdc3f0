//! Arcs on the bit grid against points sampled along them.

use planner::{Cell, Grid};
use proptest::prelude::*;
use vehicle::{Point, Vector};

use crate::reference::{small_config, wild_observation};

/// Sampled points are this far apart, in cells.
const APART: f64 = 2e-3;

/// An arc may be refused when an occupied cell is this near, in cells.
const NEAR: f64 = 0.01;

/// Whether a place, in cells, is in an occupied cell or outside the grid; the
/// cells are made larger, or smaller, by so much.
fn is_hit(grid: &Grid, place: Point, larger: f64) -> bool {
    let (columns, rows) = (grid.columns() as f64, grid.rows() as f64);
    let outside = [(place.x, columns), (place.y, rows)]
        .iter()
        .any(|&(at, size)| at < larger || at > size - larger);
    let around = [place.x - larger, place.x, place.x + larger]
        .into_iter()
        .flat_map(|x| [place.y - larger, place.y, place.y + larger].map(|y| (x, y)));
    let occupied = |(x, y): (f64, f64)| {
        let cell = Cell {
            column: x.floor().max(0.0) as usize,
            row: y.floor().max(0.0) as usize,
        };
        let inside = (0.0..columns).contains(&x) && (0.0..rows).contains(&y);
        inside && grid.is_occupied(cell)
    };
    outside
        || match larger > 0.0 {
            true => around.into_iter().any(occupied),
            false => around.into_iter().all(occupied),
        }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn an_arc_is_free_when_no_point_of_it_is_in_an_occupied_cell(
        config in small_config(), seed: u64,
        arcs in prop::collection::vec(
            (0.0..1.0f64, 0.0..1.0f64, 0.0..6.3f64, 0.05..8.0f64, -6.0..6.0f64), 12),
    ) {
        let mut grid = Grid::new(&config);
        grid.fill(&wild_observation(seed));
        for (x, y, heading_rad, radius_m, length_m) in arcs {
            let from = Point::new(
                x * grid.x_max_m(),
                (2.0 * y - 1.0) * grid.y_max_m(),
            );
            let (sin, cos) = heading_rad.sin_cos();
            let centre = from + Vector::new(-sin, cos) * radius_m;
            let turn_rad = (length_m / radius_m).clamp(-6.2, 6.2);
            let free = grid.is_arc_free(centre, from, turn_rad);
            let points = ((radius_m * turn_rad.abs() / grid.cell_m() / APART) as usize).max(1);
            let place = |point: usize| {
                let (sin, cos) = (turn_rad * point as f64 / points as f64).sin_cos();
                let arm = from - centre;
                let at = centre + Vector::new(cos * arm.x - sin * arm.y, sin * arm.x + cos * arm.y);
                Point::new(at.x / grid.cell_m(), at.y / grid.cell_m() + (grid.rows() / 2) as f64)
            };
            let places = || (0..=points).map(place);
            if free {
                let hit = places().find(|place| is_hit(&grid, *place, 0.0));
                prop_assert_eq!(hit, None, "from {} around {} by {}", from, centre, turn_rad);
            } else {
                prop_assert!(
                    places().any(|place| is_hit(&grid, place, NEAR)),
                    "nothing in the way from {} around {} by {}", from, centre, turn_rad
                );
            }
        }
    }
}

#[test]
fn what_is_no_number_is_not_free() {
    let grid = Grid::new(&planner::PlannerConfig::default());
    let (centre, from) = (Point::new(5.0, 1.0), Point::new(5.0, 0.0));
    for bad in [f64::NAN, f64::INFINITY] {
        assert!(!grid.is_arc_free(Point::new(bad, 0.0), from, 1.0));
        assert!(!grid.is_arc_free(centre, Point::new(0.0, bad), 1.0));
        assert!(!grid.is_arc_free(centre, from, bad));
    }
}
