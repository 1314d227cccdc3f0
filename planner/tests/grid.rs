//! The bit-packed grid and its lines against cell-by-cell answers.

use planner::{Cell, Grid, PlannerConfig};
use proptest::prelude::*;
use shm_config::message::Observation;
use vehicle::Point;

use crate::course;
use crate::reference::{Dense, small_config, wild_observation};

fn filled(config: &PlannerConfig, observation: &Observation) -> Grid {
    let mut grid = Grid::new(config);
    grid.fill(observation);
    grid
}

fn differences(grid: &Grid, dense: &Dense) -> Vec<Cell> {
    assert_eq!(
        (grid.rows(), grid.columns()),
        (dense.cells.len(), dense.cells[0].len())
    );
    (0..grid.rows())
        .flat_map(|row| (0..grid.columns()).map(move |column| Cell { column, row }))
        .filter(|&cell| grid.is_occupied(cell) != dense.cells[cell.row][cell.column])
        .collect()
}

/// What a mirror along the x axis shows.
fn mirrored(observation: &Observation) -> Observation {
    let mut mirrored = *observation;
    let count = observation.ranges().len();
    for beam in 1..count {
        mirrored.ranges_m[beam] = observation.ranges_m[count - beam];
    }
    mirrored.road.left_m = observation.road.right_m;
    mirrored.road.right_m = observation.road.left_m;
    mirrored.road.heading_rad = -observation.road.heading_rad;
    for checkpoint in &mut mirrored.checkpoints {
        checkpoint.y_body_m = -checkpoint.y_body_m;
    }
    mirrored
}

/// Points on and between cell corners, on the outer edge, and on the axis.
fn place() -> impl Strategy<Value = (f64, f64)> {
    let share = || prop_oneof![4 => 0.0..=1.0, 1 => Just(0.0), 1 => Just(0.5), 1 => Just(1.0)];
    (share(), share())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_cell_agrees_with_the_reference(config in small_config(), seed: u64) {
        let observation = wild_observation(seed);
        let grid = filled(&config, &observation);
        prop_assert_eq!(differences(&grid, &Dense::new(&config, &observation)), vec![]);
    }

    #[test]
    fn a_line_is_free_when_no_cell_that_it_touches_is_occupied(
        config in small_config(), seed: u64, ends in prop::collection::vec((place(), place()), 20),
        snapped: bool,
    ) {
        let grid = filled(&config, &wild_observation(seed));
        let dense = Dense::of(&grid);
        let point = |(x, y): (f64, f64)| {
            let cells = [x * grid.columns() as f64, (y - 0.5) * grid.rows() as f64];
            let cells = if snapped { cells.map(f64::round) } else { cells };
            Point::new(cells[0] * grid.cell_m(), cells[1] * grid.cell_m())
        };
        for (from, to) in ends {
            let (from, to) = (point(from), point(to));
            let free = grid.is_segment_free(from, to);
            prop_assert_eq!(free, dense.is_free(from, to), "{} to {}", from, to);
            prop_assert_eq!(free, grid.is_segment_free(to, from), "and back");
        }
    }

    #[test]
    fn left_and_right_are_treated_alike(config in small_config(), seed: u64) {
        let observation = wild_observation(seed);
        let grid = filled(&config, &observation);
        let mirror = filled(&config, &mirrored(&observation));
        for row in 0..grid.rows() {
            for column in 0..grid.columns() {
                let across = Cell { column, row: grid.rows() - 1 - row };
                prop_assert_eq!(grid.is_occupied(Cell { column, row }), mirror.is_occupied(across));
            }
        }
    }

    #[test]
    fn the_start_is_always_free(config in small_config(), seed: u64) {
        let grid = filled(&config, &wild_observation(seed));
        prop_assert!(grid.is_segment_free(Point::origin(), Point::origin()));
    }
}

#[test]
fn the_papers_grid_agrees_with_the_reference() {
    let config = PlannerConfig::default();
    let mut grid = Grid::new(&config);
    assert_eq!((grid.columns(), grid.rows()), (600, 400));
    for seed in 0..12 {
        let observation = course::random_scene(seed);
        // The same grid again and again: nothing of the last scene may stay.
        grid.fill(&observation);
        let dense = Dense::new(&config, &observation);
        assert_eq!(differences(&grid, &dense), vec![], "seed {seed}");
    }
}

#[test]
fn beams_at_full_range_mark_nothing() {
    let config = PlannerConfig::default();
    let mut observation = Observation {
        beam_count: 240,
        lidar_max_m: 20.0,
        ..Observation::default()
    };
    observation.ranges_m.fill(20.0);
    observation.road.left_m = 100.0;
    observation.road.right_m = 100.0;
    let grid = filled(&config, &observation);
    let corner = |y_m| Point::new(29.99, y_m);
    assert!(grid.is_segment_free(corner(-9.99), corner(9.99)));
    observation.ranges_m[0] = 19.99;
    let grid = filled(&config, &observation);
    assert!(!grid.is_segment_free(Point::origin(), corner(0.0)));
}

/// Rule of the start: from too near, every way that comes no nearer is free.
#[test]
fn a_car_too_near_to_an_obstacle_may_leave_it_but_not_approach_it() {
    let config = PlannerConfig::default();
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.ranges_m.fill(50.0);
    // 0.3 m to the left; the inflated disc would hold the start.
    observation.ranges_m[60] = 0.3;
    observation.road.left_m = 5.0;
    observation.road.right_m = 5.0;
    let grid = filled(&config, &observation);
    let free = |x_m, y_m| grid.is_segment_free(Point::origin(), Point::new(x_m, y_m));
    assert!(free(2.0, 0.0) && free(2.0, -1.0) && free(0.0, -2.0));
    assert!(!free(0.0, 0.2) && !free(1.0, 1.0));
}

/// Rule of the start: a used-up margin does not hold the car.
#[test]
fn a_car_beside_the_corridor_may_return_to_it() {
    let config = PlannerConfig::default();
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.ranges_m.fill(50.0);
    observation.road.left_m = 0.2;
    observation.road.right_m = 10.3;
    let grid = filled(&config, &observation);
    let free = |x_m, y_m| grid.is_segment_free(Point::origin(), Point::new(x_m, y_m));
    assert!(free(5.0, -3.0) && free(5.0, 0.0));
    assert!(!free(5.0, 0.2), "but not further out");
}
