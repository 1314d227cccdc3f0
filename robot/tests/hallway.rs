//! A robot without a map drives down a hallway and round its corner, by planner and
//! controller as they are: road and checkpoints come from the scan alone.

use robot::route::corridor::Search;
use robot::{Bicycle, Observation, Point, scan};
use shm_config::Instant;
use shm_config::config::{Clock, Config};
use stack::Stack;

const PERIOD_NS: u64 = 100_000_000;
/// Half the width of the hallway, m.
const HALF_M: f64 = 4.0;
/// The middle of the hallway behind the corner, m, and its end.
const CORNER_M: f64 = 40.0;
const END_M: f64 = 90.0;

/// The walls, from point to point: along x, then round a corner along y, to the left or,
/// mirrored, to the right.
fn walls(side: f64) -> Vec<[Point; 2]> {
    let (inner_m, outer_m) = (CORNER_M - HALF_M, CORNER_M + HALF_M);
    let left = [
        (-10.0, HALF_M),
        (inner_m, HALF_M),
        (inner_m, END_M),
        (outer_m, END_M),
    ];
    let right = [
        (outer_m, END_M),
        (outer_m, -HALF_M),
        (-10.0, -HALF_M),
        (-10.0, HALF_M),
    ];
    let lines = [left, right];
    let walls = lines.iter().flat_map(|line| line.windows(2));
    let point = |(x, y): (f64, f64)| Point::new(x, side * y);
    walls.map(|pair| [point(pair[0]), point(pair[1])]).collect()
}

/// Distance to the nearest wall in a direction, m.
fn range_m(walls: &[[Point; 2]], from: Point, direction_rad: f64) -> f64 {
    let way = Point::new(direction_rad.cos(), direction_rad.sin()).coords;
    let met = walls.iter().filter_map(|[begin, end]| {
        let wall = end - begin;
        let across = way.perp(&wall);
        let to = begin - from;
        let along_m = to.perp(&wall) / across;
        let share = to.perp(&way) / across;
        (along_m > 0.0 && (0.0..=1.0).contains(&share)).then_some(along_m)
    });
    met.fold(f64::INFINITY, f64::min)
}

fn is_inside(place: Point, side: f64) -> bool {
    let (x, y) = (place.x, side * place.y);
    let first = (-10.0..=CORNER_M + HALF_M).contains(&x) && y.abs() <= HALF_M;
    let second = (x - CORNER_M).abs() <= HALF_M && (-HALF_M..=END_M).contains(&y);
    first || second
}

/// Drives until the car is 20 m before the end, and returns the ticks it took.
fn drive(side: f64) -> u64 {
    let mut config = Config::default();
    config.run.clock = Clock::Lockstep;
    config.planner.speed_mps = 4.0;
    let mut stack = Stack::new(&config).expect("a planner");
    let walls = walls(side);
    let fan = config.scanner.fan();
    let mut car = Bicycle::new(config.vehicle);
    let search = Search {
        half_width_m: config.vehicle.width_m / 2.0 + 0.5,
        ahead_m: 30.0,
        side_max_m: 20.0,
    };
    for tick in 1..=1_000 {
        let (place, heading_rad) = (car.state.position, car.state.heading_rad);
        let mut observation = Observation::default();
        car.fill(&mut observation.ego);
        observation.set_fan(&fan);
        scan(&mut observation, |rad| {
            range_m(&walls, place, heading_rad + rad)
        });
        let max_m = observation.lidar_max_m;
        let ranges = observation.ranges().to_vec();
        let beams = ranges
            .iter()
            .enumerate()
            .filter(|(_, range_m)| **range_m < max_m);
        let beams = beams.map(|(k, range_m)| (fan.angle_rad(k), f64::from(*range_m)));
        assert!(search.fill(&mut observation, beams), "a way on at {place}");
        observation.header.tick = tick;
        observation.header.sequence = tick;
        observation.header.taken_ns = Instant(tick * PERIOD_NS).0;
        stack.plan(&observation);
        let step = *stack.control(&observation);
        car.advance(step.command.action(), 0.1);
        let corners = config.vehicle.footprint().corners(&car.state.pose());
        assert!(
            corners.iter().all(|corner| is_inside(*corner, side)),
            "touches a wall at {place} after {tick} ticks"
        );
        if side * car.state.position.y > END_M - 20.0 {
            return tick;
        }
    }
    panic!("stands at {}", car.state.position);
}

#[test]
fn a_robot_without_a_map_drives_down_a_hallway_and_round_its_corner() {
    for side in [1.0, -1.0] {
        let ticks = drive(side);
        // 36 m and 70 m at 4 m/s, with a slower corner.
        assert!((250..900).contains(&ticks), "{ticks}");
    }
}
