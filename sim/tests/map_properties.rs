//! Properties of every map, for seeds and configurations that were not recorded.

use parry2d_f64::math::{Pose, Vector as ParryVector};
use parry2d_f64::query::intersection_test;
use parry2d_f64::shape::Cuboid;
use sim::lane::{Curve, Lane};
use sim::map::{BlockKind, BlockPlan, Map, MapConfig, MapError};
use sim::road::{LaneId, Network};
use sim::spawn::{Obstacle, ObstacleKind, Scenario, ScenarioConfig, ScenarioError, Spawn};
use vehicle::Point;

/// A block of consecutive small seeds and one of large ones.
fn seeds() -> impl Iterator<Item = u64> {
    (0..1000).chain(100_000..100_400)
}

fn scenario(seed: u64) -> Scenario {
    Scenario::generate(&ScenarioConfig::default(), seed).expect("a scenario")
}

#[test]
fn every_seed_gives_a_drivable_map() {
    for seed in seeds() {
        let scenario = scenario(seed);
        check_map(&scenario.map, seed);
        let network = &scenario.map.network;
        let roads = &scenario.ego.route.roads;
        assert!(roads.len() >= 4, "seed {seed}: a route of {}", roads.len());
        for pair in roads.windows(2) {
            let (road, next) = (network.road(pair[0]), network.road(pair[1]));
            assert_eq!(road.to, next.from, "seed {seed}");
            assert_continues(network, (road.first_lane, next.first_lane), seed);
        }
    }
}

fn check_map(map: &Map, seed: u64) {
    let network = &map.network;
    for (lane, bounds) in network.lanes().iter().zip(network.bounds()) {
        let numbers = [
            lane.length_m,
            lane.start_world.x,
            lane.start_world.y,
            lane.end_world.x,
            lane.end_world.y,
            lane.heading_at(lane.length_m),
        ];
        assert!(
            numbers.iter().all(|n| n.is_finite()),
            "seed {seed}: {lane:?}"
        );
        assert!(lane.length_m > 1.0 && lane.width_m == map.lane_width_m);
        for corner in lane.surface() {
            assert!(bounds.contains(corner, 1e-6), "seed {seed}: {lane:?}");
        }
    }
    for (before, block) in map.blocks.iter().zip(&map.blocks[1..]) {
        let entry = block.entry.expect("every later block has an entry");
        assert!(before.sockets.contains(&entry), "seed {seed}");
    }
}

/// Where two roads of equal width meet, their lanes meet.
fn assert_continues(network: &Network, (from, to): (LaneId, LaneId), seed: u64) {
    let (from, to) = (network.lane(from), network.lane(to));
    let gap_m = (to.start_world - from.end_world).norm();
    assert!(gap_m < 1e-6, "seed {seed}: a gap of {gap_m} m");
    let turn_rad = from.forward_at(from.length_m).angle(&to.forward_at(0.0));
    assert!(turn_rad < 1e-6, "seed {seed}: a kink of {turn_rad} rad");
}

#[test]
fn the_same_seed_gives_the_same_scenario() {
    for seed in [0, 87, 100_001] {
        let (first, second) = (scenario(seed), scenario(seed));
        assert_eq!(first.map.network.lanes(), second.map.network.lanes());
        assert_eq!(first.ego, second.ego, "seed {seed}");
        assert_eq!(first.obstacles, second.obstacles, "seed {seed}");
        assert_eq!(first.traffic, second.traffic, "seed {seed}");
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Role {
    Ego,
    Car,
    Obstacle,
}

struct Body {
    role: Role,
    lane: LaneId,
    pose: Pose,
    shape: Cuboid,
}

impl Body {
    fn new(
        (role, lane): (Role, LaneId),
        (position_world, heading_rad): (Point, f64),
        (length_m, width_m): (f64, f64),
    ) -> Body {
        let center = ParryVector::new(position_world.x, position_world.y);
        Body {
            role,
            lane,
            pose: Pose::new(center, heading_rad),
            shape: Cuboid::new(ParryVector::new(length_m / 2.0, width_m / 2.0)),
        }
    }

    fn car(role: Role, car: &Spawn) -> Body {
        let (model, place) = (car.kind.model(), &car.place);
        Body::new(
            (role, place.lane),
            (place.position_world, place.heading_rad),
            (model.length_m, model.width_m),
        )
    }

    fn obstacle(obstacle: &Obstacle) -> Body {
        let size_m = match obstacle.kind {
            // Boxes around the cylinders.
            ObstacleKind::Cone => (0.4, 0.4),
            ObstacleKind::Warning => (1.0, 1.0),
            // Its long side is across the lane.
            ObstacleKind::Barrier => (0.3, 2.0),
            ObstacleKind::BrokenDown(kind) => (kind.model().length_m, kind.model().width_m),
        };
        Body::new(
            (Role::Obstacle, obstacle.lane),
            (obstacle.position_world, obstacle.heading_rad),
            size_m,
        )
    }

    fn overlaps(&self, other: &Body) -> bool {
        intersection_test(&self.pose, &self.shape, &other.pose, &other.shape)
            .expect("two boxes")
            .intersecting
    }
}

fn bodies(scenario: &Scenario) -> Vec<Body> {
    let cars = scenario.traffic.iter().flat_map(|group| &group.cars);
    let mut bodies = vec![Body::car(Role::Ego, &scenario.ego)];
    bodies.extend(cars.map(|car| Body::car(Role::Car, &car.car)));
    bodies.extend(scenario.obstacles.iter().map(Body::obstacle));
    bodies
}

/// The simulator lets a few bodies overlap at spawn, and so must we: a car on
/// the slanted lane of a ramp with one on the main road, and an obstacle near
/// the end of its lane with a car at the start of the next.
#[test]
fn bodies_overlap_only_at_ramps_and_behind_obstacles() {
    let (mut pairs, mut tapers, mut obstacles) = (0, 0, 0);
    for seed in seeds() {
        let scenario = scenario(seed);
        let bodies = bodies(&scenario);
        let lanes: &[Lane] = scenario.map.network.lanes();
        let on_taper = |body: &Body| matches!(lanes[body.lane.index()].curve, Curve::Taper(_));
        for (index, a) in bodies.iter().enumerate() {
            for b in bodies[index + 1..].iter().filter(|b| a.overlaps(b)) {
                pairs += 1;
                let roads = (name(&scenario, a), name(&scenario, b));
                match (a.role, b.role) {
                    _ if on_taper(a) || on_taper(b) => tapers += 1,
                    (Role::Car, Role::Obstacle) if a.lane != b.lane => obstacles += 1,
                    _ => panic!("seed {seed}: bodies overlap on {roads:?}"),
                }
                assert!(a.role != Role::Ego, "seed {seed}: the ego begins in a body");
            }
        }
    }
    println!("{pairs} pairs overlap: {tapers} on slanted lanes, {obstacles} with an obstacle");
    assert!(
        pairs < 100,
        "{pairs} pairs overlap: far more than in the simulator"
    );
}

fn name(scenario: &Scenario, body: &Body) -> String {
    let network = &scenario.map.network;
    network.road_name(network.road_of(body.lane))
}

#[test]
fn any_sequence_lane_count_and_width_generates_or_says_why_not() {
    let mut made = 0;
    for (letters, seeds) in [
        ("SCrRXTO", 0..20),
        ("OTXRrCS", 0..20),
        ("", 0..2),
        ("X", 0..5),
    ] {
        for (lane_count, lane_width_m) in [(1, 3.0), (2, 4.5), (3, 3.5), (5, 5.0)] {
            let blocks = BlockPlan::parse(letters).expect("block letters");
            let map = MapConfig {
                blocks,
                lane_count,
                lane_width_m,
                ..MapConfig::default()
            };
            let config = ScenarioConfig {
                map,
                traffic_density: 0.3,
                accident_probability: 1.0,
                ..ScenarioConfig::default()
            };
            for seed in seeds.clone() {
                match Scenario::generate(&config, seed) {
                    Ok(scenario) => {
                        check_map(&scenario.map, seed);
                        made += 1;
                    }
                    Err(ScenarioError::Map(MapError::NoMap { .. })) => {}
                    Err(other) => panic!("{letters} seed {seed}: {other}"),
                }
            }
        }
    }
    assert!(made > 100, "only {made} made");
}

#[test]
fn varied_scenarios_are_of_many_kinds_and_each_seed_has_its_own() {
    let plain = ScenarioConfig::default();
    assert_eq!(plain.of_seed(7), plain);
    let config = ScenarioConfig {
        varied: true,
        ..plain
    };
    let (mut lanes, mut blocks, mut densities) = ([0; 3], [0; 7], Vec::new());
    for seed in 0..400 {
        let own = config.of_seed(seed);
        assert_eq!(own, config.of_seed(seed));
        let BlockPlan::Random(count) = own.map.blocks else {
            panic!("{own:?}");
        };
        lanes[own.map.lane_count - 2] += 1;
        blocks[count - 1] += 1;
        densities.push(own.traffic_density);
        assert!((0.0..=1.0).contains(&own.accident_probability), "{own:?}");
        assert!((20.0..=40.0).contains(&own.traffic_kmh), "{own:?}");
        assert!(
            (0.0..=0.05).contains(&own.noise.drop_probability),
            "{own:?}"
        );
        assert!((0.0..=0.1).contains(&own.noise.range_m), "{own:?}");
        if seed < 40 {
            let scenario = Scenario::generate(&config, seed).expect("a scenario");
            check_map(&scenario.map, seed);
            let network = &scenario.map.network;
            let road = network.road(network.road_of(scenario.ego.place.lane));
            assert_eq!(usize::from(road.lane_count), own.map.lane_count);
        }
    }
    let mut run = shm_config::config::Config::default();
    run.world.varied = true;
    let of_run = sim::WorldConfig::from(&run).scenario();
    assert_eq!(of_run.expect("a configuration"), config);
    assert!(lanes.iter().all(|count| *count > 100), "{lanes:?}");
    assert!(blocks.iter().all(|count| *count > 30), "{blocks:?}");
    densities.sort_by(f64::total_cmp);
    assert!(
        densities[20] < 0.03 && densities[380] > 0.27,
        "{densities:?}"
    );
    assert!(densities.iter().all(|density| (0.0..0.3).contains(density)));
}

#[test]
fn impossible_configurations_are_refused() {
    let default = MapConfig::default;
    let cases = [
        MapConfig {
            lane_count: 0,
            ..default()
        },
        MapConfig {
            lane_count: 6,
            ..default()
        },
        MapConfig {
            lane_width_m: f64::NAN,
            ..default()
        },
        MapConfig {
            lane_width_m: f64::INFINITY,
            ..default()
        },
        MapConfig {
            exit_length_m: -1.0,
            ..default()
        },
        MapConfig {
            blocks: BlockPlan::Random(usize::MAX),
            ..default()
        },
        MapConfig {
            blocks: BlockPlan::Sequence(vec![BlockKind::First]),
            ..default()
        },
    ];
    for config in cases {
        assert!(Map::generate(&config, 0).is_err(), "{config:?}");
    }
    assert_eq!(BlockPlan::parse("SCI"), Err(MapError::UnknownBlock('I')));
    for (density, probability) in [(f64::NAN, 0.5), (0.1, f64::NAN), (-0.1, 0.5), (0.1, 1.5)] {
        let config = ScenarioConfig {
            traffic_density: density,
            accident_probability: probability,
            ..ScenarioConfig::default()
        };
        assert!(Scenario::generate(&config, 0).is_err(), "{config:?}");
    }
}
