//! The recorded scenarios once more, as sums that fit into the repository: a
//! clone without the full record still notices a changed map.

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
            // The record has micrometres, its sums two decimals.
            let near = (theirs - ours).abs() < 0.02;
            assert!(near, "seed {seed} column {}: {theirs} recorded, ours {ours}", column + 2);
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
        obstacles.map(|o| o.position_world.x + o.position_world.y).sum(),
        cars.len() as f64,
        cars.iter().map(|c| along(&c.car.place)).sum(),
        forces + scenario.ego.forces.engine_n,
        cars.iter().map(|c| f64::from(c.overtake_timer)).sum(),
    ]
}
