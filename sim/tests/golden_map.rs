//! Maps, obstacles and traffic against those recorded from MetaDrive (commit
//! c29cc37). The record is found through `VLAPS_GOLDEN` (a folder or the file
//! itself) or beside the repository; without it these tests say so and pass,
//! and `map_digest.rs` still guards the same maps.
//!
//! A recorded seed may carry a `config` (`map`, a number or letters,
//! `lane_count`, `lane_width_m`, `traffic_density`, `accident_probability`)
//! where it was not made with the paper's.

use std::f64::consts::TAU;
use std::fs::File;
use std::path::PathBuf;

use flate2::read::GzDecoder;
use serde_json::Value;
use sim::Parameters;
use sim::lane::{Curve, Lane, LineColor, LineType, Turn};
use sim::map::BlockPlan;
use sim::road::{LaneId, Network, NodeId};
use sim::spawn::{ObstacleKind, Place, Route, Scenario, ScenarioConfig};
use vehicle::Point;

const FILE: &str = "golden_100.json.gz";
/// Positions and lengths, m; angles, rad.
const TOLERANCE: f64 = 1e-3;

fn golden() -> Option<Value> {
    let beside = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data");
    let mut path = std::env::var_os("VLAPS_GOLDEN").map_or(beside, PathBuf::from);
    if path.is_dir() {
        path.push(FILE);
    }
    let Ok(file) = File::open(&path) else {
        println!(
            "skipped: no record at {} (set VLAPS_GOLDEN)",
            path.display()
        );
        return None;
    };
    let text = GzDecoder::new(file);
    Some(serde_json::from_reader(text).expect("the record is JSON"))
}

fn config(recorded: &Value) -> ScenarioConfig {
    let mut config = ScenarioConfig::default();
    let given = &recorded["config"];
    if let Some(count) = given["map"].as_u64() {
        config.map.blocks = BlockPlan::Random(count as usize);
    }
    if let Some(letters) = given["map"].as_str() {
        config.map.blocks = BlockPlan::parse(letters).expect("block letters");
    }
    if let Some(count) = given["lane_count"].as_u64() {
        config.map.lane_count = count as usize;
    }
    for (key, value) in [
        ("lane_width_m", &mut config.map.lane_width_m),
        ("traffic_density", &mut config.traffic_density),
        ("accident_probability", &mut config.accident_probability),
    ] {
        *value = given[key].as_f64().unwrap_or(*value);
    }
    config
}

/// Runs a comparison on every recorded seed; all differences are listed.
fn compare(what: fn(&Value, &Scenario, &mut Differences)) {
    let Some(golden) = golden() else { return };
    let seeds = golden.as_object().expect("the record is an object");
    assert!(!seeds.is_empty(), "a record without seeds");
    let mut differences = Differences::default();
    for (seed, recorded) in seeds {
        let number = seed.parse().expect("a seed is a number");
        let scenario = Scenario::generate(&config(recorded), number).expect("a scenario");
        differences.seed = seed.clone();
        what(recorded, &scenario, &mut differences);
    }
    let count = differences.list.len();
    let shown: Vec<String> = differences.list.into_iter().take(40).collect();
    assert!(count == 0, "{count} differences:\n{}", shown.join("\n"));
}

#[derive(Default)]
struct Differences {
    seed: String,
    list: Vec<String>,
}

impl Differences {
    fn same<T: PartialEq + std::fmt::Debug>(&mut self, what: &str, recorded: T, ours: T) {
        if recorded != ours {
            let seed = &self.seed;
            self.list.push(format!(
                "seed {seed}: {what}: recorded {recorded:?}, ours {ours:?}"
            ));
        }
    }

    fn near(&mut self, what: &str, recorded: f64, ours: f64) {
        let near = (recorded - ours).abs() <= TOLERANCE;
        self.same(what, recorded, if near { recorded } else { ours });
    }

    fn near_angle(&mut self, what: &str, recorded: f64, ours: f64) {
        let turns = ((ours - recorded) / TAU).round();
        self.near(what, recorded, ours - turns * TAU);
    }

    fn near_point(&mut self, what: &str, recorded: &Value, ours: Point) {
        self.near(&format!("{what} x"), number(&recorded[0]), ours.x);
        self.near(&format!("{what} y"), number(&recorded[1]), ours.y);
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

fn array(value: &Value) -> &[Value] {
    value.as_array().expect("an array")
}

fn names(value: &Value) -> Vec<&str> {
    array(value)
        .iter()
        .map(|v| v.as_str().expect("a name"))
        .collect()
}

#[test]
fn blocks_equal_the_simulators() {
    compare(|recorded, scenario, differences| {
        let blocks = array(&recorded["blocks"]);
        differences.same("blocks", blocks.len(), scenario.map.blocks.len());
        for (index, (theirs, ours)) in blocks.iter().zip(&scenario.map.blocks).enumerate() {
            let what = |field: &str| format!("block {index} {field}");
            differences.same(
                &what("ID"),
                theirs["ID"].as_str(),
                Some(ours.kind.letter().to_string().as_str()),
            );
            differences.same(&what("seed"), theirs["seed"].as_u64(), Some(ours.seed));
            differences.same(
                &what("trials"),
                theirs["trials"].as_u64(),
                Some(u64::from(ours.trials)),
            );
            let socket = ours.entry.map(|entry| {
                let before = &scenario.map.blocks[index - 1];
                format!(
                    "{}{}-socket{}",
                    index - 1,
                    before.kind.letter(),
                    entry.number
                )
            });
            differences.same(
                &what("socket"),
                theirs["pre_socket"].as_str(),
                socket.as_deref(),
            );
            for (key, value) in parameters(&ours.parameters) {
                differences.near(&what(key), number(&theirs["cfg"][key]), value);
            }
        }
    });
}

fn parameters(parameters: &Parameters) -> Vec<(&'static str, f64)> {
    match *parameters {
        Parameters::Fixed => vec![],
        Parameters::Straight { length_m } => vec![("length", length_m)],
        Parameters::Curve {
            length_m,
            radius_m,
            angle_deg,
            turn,
        } => vec![
            ("length", length_m),
            ("radius", radius_m),
            ("angle", angle_deg),
            ("dir", if turn == Turn::Right { 1.0 } else { 0.0 }),
        ],
        Parameters::Ramp {
            length_m,
            extension_m,
        } => {
            vec![("length", length_m), ("extension_length", extension_m)]
        }
        Parameters::TIntersection { missing } => vec![("t_type", f64::from(missing))],
        Parameters::Roundabout {
            exit_radius_m,
            inner_radius_m,
        } => {
            vec![
                ("exit_radius", exit_radius_m),
                ("inner_radius", inner_radius_m),
            ]
        }
    }
}

#[test]
fn lanes_equal_the_simulators() {
    compare(|recorded, scenario, differences| {
        let network = &scenario.map.network;
        let net = recorded["net"].as_object().expect("roads");
        differences.same("roads", net.len(), network.roads().len());
        for road in (0..network.roads().len()).map(|r| sim::road::RoadId(r as u16)) {
            let name = network.road_name(road);
            let Some(theirs) = net.get(&name) else {
                differences.same(&name, true, false);
                continue;
            };
            let lanes = network.lanes_of(road);
            differences.same(&format!("{name} lanes"), array(theirs).len(), lanes.len());
            for (index, (theirs, ours)) in array(theirs).iter().zip(lanes).enumerate() {
                compare_lane(&format!("{name} {index}"), theirs, ours, differences);
            }
        }
    });
}

fn compare_lane(name: &str, theirs: &Value, ours: &Lane, differences: &mut Differences) {
    let what = |field: &str| format!("{name} {field}");
    let kind = match ours.curve {
        Curve::Straight(_) => "StraightLane",
        Curve::Taper(_) => "ExtendingLane",
        Curve::Arc(_) => "CircularLane",
    };
    differences.same(&what("type"), theirs["type"].as_str(), Some(kind));
    differences.near(&what("width"), number(&theirs["width"]), ours.width_m);
    differences.near(&what("length"), number(&theirs["length"]), ours.length_m);
    differences.near_point(&what("start"), &theirs["start"], ours.start_world);
    differences.near_point(&what("end"), &theirs["end"], ours.end_world);
    differences.same(
        &what("lines"),
        names(&theirs["lines"]),
        ours.lines.map(line_name).to_vec(),
    );
    let yellow = names(&theirs["colors"])[0] != "(1, 1, 1, 1)";
    differences.same(
        &what("yellow"),
        yellow,
        ours.left_color == LineColor::Yellow,
    );
    if let Curve::Arc(arc) = ours.curve {
        differences.near_point(&what("center"), &theirs["center"], arc.center_world);
        differences.near(&what("radius"), number(&theirs["radius"]), arc.radius_m);
        differences.near_angle(
            &what("phase"),
            number(&theirs["start_phase"]),
            arc.start_phase_rad,
        );
        differences.near(&what("angle"), number(&theirs["angle"]), arc.angle_rad);
        differences.same(
            &what("clockwise"),
            theirs["clockwise"].as_bool(),
            Some(arc.turn == Turn::Right),
        );
    }
}

fn line_name(line: LineType) -> &'static str {
    match line {
        LineType::None => "UNKNOWN_LINE",
        LineType::Broken => "ROAD_LINE_BROKEN_SINGLE_WHITE",
        LineType::Continuous => "ROAD_LINE_SOLID_SINGLE_WHITE",
        LineType::Side => "ROAD_EDGE_BOUNDARY",
    }
}

fn checkpoints(network: &Network, route: &Route) -> Vec<String> {
    let name = |node: &NodeId| network.nodes()[node.index()].to_string();
    route.checkpoints(network).iter().map(name).collect()
}

fn lane_name(network: &Network, lane: LaneId) -> String {
    let road = network.road_name(network.road_of(lane));
    format!("{road}|{}", network.index_in_road(lane))
}

fn recorded_lane_name(lane: &Value) -> String {
    let text = |v: &Value| v.as_str().expect("a node").to_string();
    format!("{}|{}|{}", text(&lane[0]), text(&lane[1]), lane[2])
}

#[test]
fn ego_and_route_equal_the_simulators() {
    compare(|recorded, scenario, differences| {
        let network = &scenario.map.network;
        let (theirs, ours) = (&recorded["ego"], &scenario.ego);
        compare_place("ego", theirs, (network, &ours.place), differences);
        differences.near(
            "ego engine",
            number(&theirs["engine"]),
            ours.forces.engine_n,
        );
        differences.near("ego brake", number(&theirs["brake"]), ours.forces.brake);
        let route = checkpoints(network, &ours.route);
        differences.same(
            "checkpoints",
            names(&recorded["ckpt"]),
            route.iter().map(String::as_str).collect(),
        );
        differences.near(
            "route length",
            number(&recorded["route_len"]),
            ours.route.length_m(network),
        );
    });
}

fn compare_place(
    name: &str,
    theirs: &Value,
    (network, ours): (&Network, &Place),
    differences: &mut Differences,
) {
    let lane = lane_name(network, ours.lane);
    differences.same(
        &format!("{name} lane"),
        recorded_lane_name(&theirs["lane"]),
        lane,
    );
    differences.near_point(name, &theirs["pos"], ours.position_world);
    differences.near_angle(
        &format!("{name} heading"),
        number(&theirs["heading"]),
        ours.heading_rad,
    );
}

#[test]
fn obstacles_equal_the_simulators() {
    compare(|recorded, scenario, differences| {
        let objects = array(&recorded["objects"]);
        differences.same("obstacles", objects.len(), scenario.obstacles.len());
        for (index, (theirs, ours)) in objects.iter().zip(&scenario.obstacles).enumerate() {
            let name = format!("obstacle {index}");
            let class = match ours.kind {
                ObstacleKind::Cone => "TrafficCone",
                ObstacleKind::Warning => "TrafficWarning",
                ObstacleKind::Barrier => "TrafficBarrier",
                ObstacleKind::BrokenDown(kind) => kind.model().name,
            };
            differences.same(&name, theirs["cls"].as_str(), Some(class));
            differences.near_point(&name, &theirs["pos"], ours.position_world);
            differences.near_angle(
                &format!("{name} heading"),
                number(&theirs["heading"]),
                ours.heading_rad,
            );
        }
    });
}

#[test]
fn traffic_equals_the_simulators() {
    compare(|recorded, scenario, differences| {
        let network = &scenario.map.network;
        let groups = array(&recorded["traffic"]);
        differences.same("groups", groups.len(), scenario.traffic.len());
        // Recorded with the last block first: the simulator pops from the end.
        for (index, (theirs, ours)) in groups.iter().rev().zip(&scenario.traffic).enumerate() {
            let trigger = names(&theirs["trigger"]).join("|");
            differences.same("trigger", trigger, network.road_name(ours.trigger));
            let cars = array(&theirs["vehicles"]);
            differences.same("cars", cars.len(), ours.cars.len());
            for (place, (theirs, ours)) in cars.iter().zip(&ours.cars).enumerate() {
                let name = format!("group {index} car {place}");
                let model = ours.car.kind.model();
                differences.same(&name, theirs["cls"].as_str(), Some(model.name));
                compare_place(&name, theirs, (network, &ours.car.place), differences);
                differences.near(
                    &name,
                    number(&theirs["long"]),
                    ours.car.place.longitudinal_m,
                );
                differences.near(&name, number(&theirs["size"][0]), model.length_m);
                differences.near(&name, number(&theirs["size"][1]), model.width_m);
                differences.near(&name, number(&theirs["mass"]), model.mass_kg);
                differences.near(&name, number(&theirs["engine"]), ours.car.forces.engine_n);
                differences.near(&name, number(&theirs["brake"]), ours.car.forces.brake);
                differences.same(
                    &name,
                    theirs["overtake_timer"].as_u64(),
                    Some(u64::from(ours.overtake_timer)),
                );
                let route = checkpoints(network, &ours.car.route);
                differences.same(
                    &name,
                    names(&theirs["ckpt"]),
                    route.iter().map(String::as_str).collect(),
                );
            }
        }
    });
}
