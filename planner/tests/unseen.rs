//! Where no beam looks, nothing is taken for free.

use planner::{Cell, Grid, PlannerConfig};
use proptest::prelude::*;
use shm_config::config::Config;
use shm_config::config::planner::Method;
use shm_config::message::{Observation, Plan, PlanOutcome};
use vehicle::{Point, Scanner, Vehicle};

/// A wide free road, seen by this scanner.
fn observation(scanner: &Scanner) -> Observation {
    let mut observation = Observation {
        lidar_max_m: 50.0,
        ..Observation::default()
    };
    observation.set_fan(&scanner.fan());
    observation.ranges_m.fill(50.0);
    (observation.road.left_m, observation.road.right_m) = (100.0, 100.0);
    observation.checkpoints[0].x_body_m = 60.0;
    observation.checkpoints[1].x_body_m = 120.0;
    observation
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Against the definition, cell by cell; cells within a hair of a limit may be either.
    #[test]
    fn a_cell_ahead_is_free_where_a_beam_looks(
        deg in 10.0..359.0f64, heading_deg in -180.0..180.0f64,
        x_m in -3.0..7.0f64, y_m in -1.0..1.0f64, beams in 8..2048u32,
    ) {
        let scanner = Scanner { beams, field_of_view_deg: deg, heading_deg, x_m, y_m, ..Scanner::default() };
        let config = PlannerConfig { cell_m: 0.2, ..PlannerConfig::default() };
        let car = Vehicle::default().footprint();
        let mut grid = Grid::new(&config).of(car);
        grid.fill(&observation(&scanner));
        let sight = scanner.fan().sight();
        let is_seen = |at: Point| {
            let around = [(-1e-6, 0.0), (1e-6, 0.0), (0.0, -1e-6), (0.0, 1e-6)];
            let seen = around.map(|(x, y)| sight.covers(at + vehicle::Vector::new(x, y), car.width_m));
            seen.iter().all(|&one| one == seen[0]).then_some(seen[0])
        };
        let cells = (0..grid.columns() * grid.rows()).map(|k| Cell { column: k / grid.rows(), row: k % grid.rows() });
        let seen: Vec<Option<bool>> = cells.map(|cell| is_seen(grid.cell_middle(cell))).collect();
        for row in 0..grid.rows() {
            for column in 0..grid.columns() {
                let cell = Cell { column, row };
                let at = grid.cell_middle(cell);
                if (at.x - car.length_m / 2.0).abs() < 0.2 {
                    continue;
                }
                // The front of the body without a turn, to a cell inside of its corners.
                let beside = (car.width_m / 2.0 / grid.cell_m() - 1.0) as usize;
                let front = row.saturating_sub(beside)..=(row + beside).min(grid.rows() - 1);
                let seen = |row: usize| seen[column * grid.rows() + row];
                if front.clone().any(|row| seen(row).is_none()) {
                    continue;
                }
                let is_unseen = front.into_iter().any(|row| seen(row) == Some(false));
                let expected = at.x > car.length_m / 2.0 && is_unseen;
                prop_assert_eq!(grid.is_occupied(cell), expected, "{:?} at {}", cell, at);

            }
        }
    }
}

#[test]
fn without_a_beam_all_that_is_ahead_of_the_bumper_is_occupied() {
    let scanner = Scanner {
        beams: 0,
        ..Scanner::default()
    };
    let car = Vehicle::default().footprint();
    let mut grid = Grid::new(&PlannerConfig::default()).of(car);
    grid.fill(&observation(&scanner));
    for row in 0..grid.rows() {
        for column in 0..grid.columns() {
            let cell = Cell { column, row };
            let ahead_m = grid.cell_middle(cell).x - car.length_m / 2.0;
            if ahead_m.abs() > grid.cell_m() {
                assert_eq!(grid.is_occupied(cell), ahead_m > 0.0, "{cell:?}");
            }
        }
    }
}

const METHODS: [Method; 4] = [
    Method::RrtStar,
    Method::Informed,
    Method::Kinodynamic,
    Method::Mpc,
];

/// The plan of a method on a free road of three lanes, seen by this scanner.
fn planned(method: Method, scanner: &Scanner) -> Plan {
    let mut config = Config::default();
    config.planner.method = method;
    config.run.clock = shm_config::config::Clock::Lockstep;
    let mut planner = planner::Planner::new(&config).expect("a planner");
    let mut plan = Plan::default();
    let mut seen = observation(scanner);
    (seen.road.left_m, seen.road.right_m) = (5.25, 5.25);
    planner.plan(&seen, &mut plan);
    plan
}

/// The plan leads at most beside what is seen.
fn assert_stands(plan: &Plan, what: &str) {
    let far_m = plan
        .waypoints()
        .iter()
        .map(|waypoint| {
            Point::new(waypoint.x_body_m, waypoint.y_body_m)
                .coords
                .norm()
        })
        .fold(0.0, f64::max);
    // The middle of the car does not pass where its bumper is now, to a cell of the grid.
    let bumper_m = Vehicle::default().length_m / 2.0;
    let stands = plan.outcome == PlanOutcome::Blocked.code() || far_m <= bumper_m + 0.05;
    assert!(stands, "{what} plans {far_m} m into what no beam sees");
}

#[test]
fn no_method_plans_into_the_scan_of_a_dead_scanner() {
    for method in METHODS {
        let dead = Scanner {
            beams: 0,
            ..Scanner::default()
        };
        assert_stands(&planned(method, &dead), &format!("{method:?}"));
    }
}

#[test]
fn every_method_drives_with_270_degrees_and_none_with_a_scanner_to_the_rear() {
    for method in METHODS {
        let front = Scanner {
            beams: 1080,
            field_of_view_deg: 270.0,
            x_m: 2.0,
            ..Scanner::default()
        };
        // It sees all that is ahead: the plan is that of the full circle.
        let (ahead, circle) = (
            planned(method, &front),
            planned(method, &Scanner::default()),
        );
        assert_ne!(ahead.outcome, PlanOutcome::Blocked.code(), "{method:?}");
        assert_eq!(ahead, circle, "{method:?}");
        let rear = Scanner {
            heading_deg: 180.0,
            x_m: -2.0,
            ..front
        };
        let behind = Scanner {
            field_of_view_deg: 150.0,
            ..rear
        };
        assert_stands(&planned(method, &behind), &format!("{method:?}"));
    }
}
