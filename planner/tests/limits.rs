//! The configuration and the room there is for it.

use planner::{Grid, PlannerConfig, RrtStar};
use shm_config::config::planner::{DISC_CELLS_MAX, NODES_MAX};
use shm_config::message::{Observation, Plan};

#[test]
fn the_defaults_are_the_papers_numbers() {
    let config = PlannerConfig::default();
    assert_eq!(
        (config.cell_m, config.x_max_m, config.y_max_m),
        (0.05, 30.0, 10.0)
    );
    assert_eq!(
        (config.inflation_m, config.iterations, config.step_m),
        (0.5, 200, 2.0)
    );
    assert_eq!((config.rewire_radius_m, config.goal_radius_m), (3.0, 1.0));
    assert_eq!((config.speed_mps, config.goal_bias), (5.0, 0.0));
    assert!(RrtStar::new(config).is_ok());
}

#[test]
fn what_the_configuration_allows_there_is_room_for() {
    let config = PlannerConfig::default();
    let most = NODES_MAX as u32 - 1;
    let of = |iterations| PlannerConfig {
        iterations,
        ..config
    };
    assert!(of(most).check().is_ok() && of(most + 1).check().is_err() && of(0).check().is_err());
    let of = |cells: f64| PlannerConfig {
        inflation_m: cells * config.cell_m,
        ..config
    };
    let most = DISC_CELLS_MAX as f64;
    assert!(of(most).check().is_ok() && of(most + 0.01).check().is_err());
    // The largest disc of all, as a cross in the grid.
    let config = of(most);
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.ranges_m[..240].fill(observation.lidar_max_m);
    observation.ranges_m[0] = 10.02;
    observation.road.left_m = 50.0;
    observation.road.right_m = 50.0;
    let mut grid = Grid::new(&config);
    grid.fill(&observation);
    let occupied =
        |x_m, y_m| grid.is_occupied(grid.cell_at(vehicle::Point::new(x_m, y_m)).unwrap());
    assert!(occupied(7.03, 0.0) && occupied(13.02, 0.0) && occupied(10.02, 3.02));
    assert!(!occupied(6.98, 0.0) && !occupied(13.07, 0.0) && !occupied(10.02, 3.07));
}

#[test]
fn a_full_tree_is_searched_to_the_last_node() {
    let config = PlannerConfig {
        iterations: NODES_MAX as u32 - 1,
        ..PlannerConfig::default()
    };
    let mut planner = RrtStar::new(config).unwrap();
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.ranges_m.fill(50.0);
    observation.road.left_m = 5.0;
    observation.road.right_m = 5.0;
    observation.checkpoints[0].x_body_m = 40.0;
    let mut plan = Plan::default();
    planner.plan(&observation, &mut plan);
    assert_eq!(plan.nodes as usize, NODES_MAX);
}

#[test]
fn a_number_out_of_range_is_named_with_its_value_and_its_limits() {
    let bad = |config: PlannerConfig| RrtStar::new(config).unwrap_err().to_string();
    let text = bad(PlannerConfig {
        cell_m: f64::NAN,
        ..PlannerConfig::default()
    });
    assert!(
        text.contains("cell_m") && text.contains("NaN") && text.contains("0.01"),
        "{text}"
    );
    let text = bad(PlannerConfig {
        step_m: -1.0,
        ..PlannerConfig::default()
    });
    assert!(
        text.contains("step_m") && text.contains("-1") && text.contains("100"),
        "{text}"
    );
}

#[test]
fn an_unknown_key_is_refused() {
    let written = toml::to_string(&PlannerConfig::default()).unwrap();
    let read: PlannerConfig = toml::from_str(&written).unwrap();
    assert_eq!(read, PlannerConfig::default());
    assert!(toml::from_str::<PlannerConfig>("step_m = 1.0\nstep = 2.0").is_err());
}
