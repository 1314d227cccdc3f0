//! The recorded scenarios as sums that fit into the repository, so that a clone without
//! the full record still notices a changed map.

use sim::map::{BlockPlan, Map, MapConfig};
use sim::road::Network;
use sim::spawn::{Place, Scenario, ScenarioConfig};

/// Made from the full record, not from this crate.
const RECORDED: &str = include_str!("scenarios_100.txt");

#[test]
fn scenarios_have_the_recorded_sums() {
    let rows: Vec<&str> = RECORDED.lines().filter(|l| !l.starts_with('#')).collect();
    assert_eq!(rows.len(), 50);
    for row in rows {
        let recorded: Vec<&str> = row.split(' ').collect();
        let seed: u64 = recorded[0].parse().expect("a seed");
        let scenario = Scenario::generate(&ScenarioConfig::default(), seed).expect("a scenario");
        let blocks = scenario.map.blocks.iter().map(|b| b.kind.letter());
        let letters: String = blocks.collect();
        assert_eq!(recorded[1], letters, "seed {seed}");
        for (column, ours) in sums(&scenario).into_iter().enumerate() {
            let theirs: f64 = recorded[column + 2].parse().expect("a number");
            // The record has micrometres, and its sums have two decimals.
            let near = (theirs - ours).abs() < 0.02;
            assert!(
                near,
                "seed {seed} column {}: {theirs} recorded, ours {ours}",
                column + 2
            );
        }
    }
}

fn sums(scenario: &Scenario) -> [f64; 14] {
    let network: &Network = &scenario.map.network;
    let lanes = network.lanes();
    let cars: Vec<_> = scenario.traffic.iter().flat_map(|g| &g.cars).collect();
    let along = |place: &Place| place.position_world.x + place.position_world.y;
    let forces = cars.iter().map(|c| c.car.forces.engine_n).sum::<f64>();
    let obstacles = scenario.obstacles.iter();
    [
        network.roads().len() as f64,
        lanes.len() as f64,
        lanes.iter().map(|l| l.length_m).sum(),
        lanes.iter().map(|l| l.end_world.x).sum(),
        lanes.iter().map(|l| l.end_world.y).sum(),
        scenario.ego.route.checkpoints(network).len() as f64,
        scenario.ego.route.length_m(network),
        f64::from(network.index_in_road(scenario.ego.place.lane)),
        scenario.obstacles.len() as f64,
        obstacles
            .map(|o| o.position_world.x + o.position_world.y)
            .sum(),
        cars.len() as f64,
        cars.iter().map(|c| along(&c.car.place)).sum(),
        forces + scenario.ego.forces.engine_n,
        cars.iter().map(|c| f64::from(c.overtake_timer)).sum(),
    ]
}

/// Blocks that ran over an earlier one and were sampled again, as recorded.
#[test]
fn resampled_blocks_take_the_recorded_number_of_trials() {
    for (seed, letters, trials, route_m) in [
        (87, "ICXC", [0, 1, 1, 4], 340.104),
        (787, "ICCC", [0, 1, 1, 3], 572.204),
        (2269, "ICXC", [0, 1, 1, 3], 443.319),
        (6695, "ICTC", [0, 1, 1, 5], 324.497),
        (7600, "ICCC", [0, 1, 1, 4], 613.71),
    ] {
        let scenario = Scenario::generate(&ScenarioConfig::default(), seed).expect("a scenario");
        let map: &Map = &scenario.map;
        let ours: String = map.blocks.iter().map(|b| b.kind.letter()).collect();
        assert_eq!(ours, letters, "seed {seed}");
        let ours: Vec<u32> = map.blocks.iter().map(|b| b.trials).collect();
        assert_eq!(ours, trials, "seed {seed}");
        let ours_m = scenario.ego.route.length_m(&map.network);
        assert!((ours_m - route_m).abs() < 1e-3, "seed {seed}: {ours_m} m");
    }
}

/// The last bit of a lane's length decides whether a ramp of 20 m has places
/// for one car or two, and with that which cars are drawn.
#[test]
fn rounding_decides_as_in_the_simulator() {
    let sequence = BlockPlan::parse("SCrRXTO").expect("block letters");
    for (blocks, seed, group, recorded) in [
        (sequence, 1, 2, ["3r0_0_|3r1_4_ 10", "2C0_1_|3r0_0_ 20"]),
        (
            BlockPlan::Random(10),
            32,
            9,
            ["9R0_1_|10r0_0_ 30", "10r1_4_|10r0_1_ 10"],
        ),
    ] {
        let map = MapConfig {
            blocks,
            ..MapConfig::default()
        };
        let config = ScenarioConfig {
            map,
            ..ScenarioConfig::default()
        };
        let scenario = Scenario::generate(&config, seed).expect("a scenario");
        let network = &scenario.map.network;
        let cars = scenario.traffic[group]
            .cars
            .iter()
            .map(|car| &car.car.place);
        let places: Vec<String> = cars
            .map(|place| {
                let road = network.road_name(network.road_of(place.lane));
                format!("{road} {}", place.longitudinal_m)
            })
            .collect();
        assert_eq!(places, recorded, "seed {seed}");
    }
}
