//! Compares the begin of episodes: lanes, checkpoints, objects, vehicles, and the first
//! observation.

use std::f64::consts::TAU;

use anyhow::{Context, ensure};
use shm_config::message::{BEAMS_MAX, Observation};
use sim::Parameters;
use sim::lane::{Arc, Curve, Lane, LineColor, LineType, Turn};
use sim::map::Block;
use sim::road::{LaneId, Network, NodeId, RoadId};
use sim::spawn::{Obstacle, ObstacleKind, Place, Route, Scenario, Spawn};
use sim::{World, WorldConfig};
use vehicle::Point;

use super::record::{self, Golden};
use super::{Row, Tally, Unit};

/// Limit of position and length errors, m, and of angle errors, rad.
const BAR_M: f64 = 1e-3;
/// Limit of feature errors.
const BAR_FEATURE: f64 = 1e-3;

#[derive(Default)]
struct Tallies {
    blocks: Tally,
    lanes: Tally,
    routes: Tally,
    egos: Tally,
    objects: Tally,
    vehicles: Tally,
    features: Tally,
}

impl Tallies {
    fn all(&mut self) -> [&mut Tally; 7] {
        [
            &mut self.blocks,
            &mut self.lanes,
            &mut self.routes,
            &mut self.egos,
            &mut self.objects,
            &mut self.vehicles,
            &mut self.features,
        ]
    }
}

/// Compares all recorded scenarios.
pub(super) fn rows(golden: &Golden) -> anyhow::Result<Vec<Row>> {
    let mut tallies = Tallies::default();
    for (&seed, recorded) in &golden.seeds {
        let config = config(recorded)?;
        compare(seed, recorded, &config, &mut tallies).with_context(|| format!("seed {seed}"))?;
        for tally in tallies.all() {
            tally.end_of(seed);
        }
    }
    let Tallies {
        blocks,
        lanes,
        routes,
        egos,
        objects,
        vehicles,
        features,
    } = tallies;
    Ok(vec![
        Row::largest(
            "blocks: kind, seed, socket, measures",
            blocks,
            Unit::M,
            BAR_M,
        ),
        Row::largest(
            "lanes: type, lines, length, ends, arcs",
            lanes,
            Unit::M,
            BAR_M,
        ),
        Row::largest("routes: checkpoints and length", routes, Unit::M, BAR_M),
        Row::largest("egos: lane, place, engine, brake", egos, Unit::M, BAR_M),
        Row::largest("objects: kind, place, heading", objects, Unit::M, BAR_M),
        Row::largest(
            "vehicles: kind, place, forces, route, size",
            vehicles,
            Unit::M,
            BAR_M,
        ),
        Row::largest(
            "first observation, each feature",
            features,
            Unit::Feature,
            BAR_FEATURE,
        ),
    ])
}

/// The configuration of the world in which a scenario was recorded.
fn config(recorded: &record::Scenario) -> anyhow::Result<WorldConfig> {
    let mut config = WorldConfig::default();
    let Some(given) = &recorded.config else {
        return Ok(config);
    };
    match &given.map {
        Some(serde_json::Value::String(letters)) => config.block_sequence.clone_from(letters),
        Some(number) => {
            let count = number
                .as_u64()
                .context("map is neither a number nor letters")?;
            config.blocks = count as usize;
        }
        None => {}
    }
    let or = |given: Option<f64>, default| given.unwrap_or(default);
    config.lane_count = given.lane_count.unwrap_or(config.lane_count);
    config.lane_width_m = or(given.lane_width_m, config.lane_width_m);
    config.traffic_density = or(given.traffic_density, config.traffic_density);
    config.accident_probability = or(given.accident_probability, config.accident_probability);
    Ok(config)
}

fn compare(
    seed: u64,
    recorded: &record::Scenario,
    config: &WorldConfig,
    tallies: &mut Tallies,
) -> anyhow::Result<()> {
    let ours = Scenario::generate(&config.scenario()?, seed)?;
    let network = &ours.map.network;
    compare_blocks(&recorded.blocks, &ours.map.blocks, &mut tallies.blocks);
    compare_lanes(recorded, network, &mut tallies.lanes);
    let route_m = (recorded.route_len - ours.ego.route.length_m(network)).abs();
    let same_route = recorded.ckpt == nodes(network, &ours.ego.route);
    tallies.routes.count(same_route.then_some(route_m), BAR_M);
    let ego = car_error(network, &recorded.ego, &ours.ego);
    tallies.egos.count(ego, BAR_M);
    pair(
        &recorded.objects,
        &ours.obstacles,
        &mut tallies.objects,
        object_error,
    );
    tallies
        .vehicles
        .missing(recorded.traffic.len().abs_diff(ours.traffic.len()));
    // Recorded with the last block first, since the simulator pops from the end.
    for (theirs, ours) in recorded.traffic.iter().rev().zip(&ours.traffic) {
        let same_trigger = theirs.trigger.join("|") == network.road_name(ours.trigger);
        pair(
            &theirs.vehicles,
            &ours.cars,
            &mut tallies.vehicles,
            |theirs, ours| {
                let same_timer = theirs.overtake_timer == Some(ours.overtake_timer);
                let same_route = theirs.ckpt == nodes(network, &ours.car.route);
                let error = car_error(network, theirs, &ours.car)?;
                (same_trigger && same_timer && same_route).then_some(error)
            },
        );
    }
    let mut world = World::new(config.clone())?;
    world.reset(seed)?;
    let mut observation = Observation::default();
    world.observe(&mut observation);
    let mut room = [0.0; 19 + BEAMS_MAX];
    let features = observation.features(&mut room).context("too many beams")?;
    let (theirs, ours) = (recorded.obs0.len(), features.len());
    ensure!(theirs == ours, "{theirs} features recorded, {ours} here");
    pair(
        &recorded.obs0,
        features,
        &mut tallies.features,
        |theirs, &ours| Some((theirs - f64::from(ours)).abs()),
    );
    Ok(())
}

/// Compares two lists item by item; items without a counterpart count as different.
fn pair<A, B>(
    theirs: &[A],
    ours: &[B],
    tally: &mut Tally,
    mut error: impl FnMut(&A, &B) -> Option<f64>,
) {
    for (theirs, ours) in theirs.iter().zip(ours) {
        tally.count(error(theirs, ours), BAR_M);
    }
    tally.missing(theirs.len().abs_diff(ours.len()));
}

fn compare_blocks(theirs: &[record::Block], ours: &[Block], tally: &mut Tally) {
    // The recording names a socket by the block before.
    let sockets: Vec<Option<String>> = (ours.iter().enumerate())
        .map(|(index, block)| {
            let (before, entry) = (index.checked_sub(1)?, block.entry?);
            let letter = ours[before].kind.letter();
            Some(format!("{before}{letter}-socket{}", entry.number))
        })
        .collect();
    let ours: Vec<_> = ours.iter().zip(&sockets).collect();
    pair(theirs, &ours, tally, |theirs, (ours, socket)| {
        let same = theirs.letter == ours.kind.letter().to_string()
            && theirs.seed == ours.seed
            && theirs.trials == ours.trials
            && theirs.pre_socket == **socket;
        let mut error = 0.0_f64;
        for (name, value) in measures(&ours.parameters) {
            let recorded = theirs.cfg.get(name).and_then(serde_json::Value::as_f64)?;
            error = error.max((recorded - value).abs());
        }
        same.then_some(error)
    });
}

/// A block's parameters by the simulator's names: m, degrees and numbers.
fn measures(parameters: &Parameters) -> Vec<(&'static str, f64)> {
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
        } => vec![("length", length_m), ("extension_length", extension_m)],
        Parameters::TIntersection { missing } => vec![("t_type", f64::from(missing))],
        Parameters::Roundabout {
            exit_radius_m,
            inner_radius_m,
        } => vec![
            ("exit_radius", exit_radius_m),
            ("inner_radius", inner_radius_m),
        ],
    }
}

fn compare_lanes(recorded: &record::Scenario, network: &Network, tally: &mut Tally) {
    let mut found = 0;
    for road in (0..network.roads().len()).map(|index| RoadId(index as u16)) {
        let lanes = network.lanes_of(road);
        match recorded.net.get(&network.road_name(road)) {
            Some(theirs) => {
                found += 1;
                pair(theirs, lanes, tally, lane_error);
            }
            None => tally.missing(lanes.len()),
        }
    }
    if found < recorded.net.len() {
        let ours = |name: &str| {
            network
                .roads()
                .iter()
                .enumerate()
                .any(|(index, _)| network.road_name(RoadId(index as u16)) == name)
        };
        let only_theirs = recorded.net.iter().filter(|(name, _)| !ours(name));
        tally.missing(only_theirs.map(|(_, lanes)| lanes.len()).sum());
    }
}

fn lane_error(theirs: &record::Lane, ours: &Lane) -> Option<f64> {
    let class = match ours.curve {
        Curve::Straight(_) => "StraightLane",
        Curve::Taper(_) => "ExtendingLane",
        Curve::Arc(_) => "CircularLane",
    };
    let lines = ours.lines.map(|line| match line {
        LineType::None => "UNKNOWN_LINE",
        LineType::Broken => "ROAD_LINE_BROKEN_SINGLE_WHITE",
        LineType::Continuous => "ROAD_LINE_SOLID_SINGLE_WHITE",
        LineType::Side => "ROAD_EDGE_BOUNDARY",
    });
    // The recorded text of yellow is cut off; that of white is complete.
    let color = match theirs.colors[0].as_str() {
        "(1, 1, 1, 1)" => LineColor::White,
        _ => LineColor::Yellow,
    };
    let arc_m = match (&theirs.arc, &ours.curve) {
        (Some(theirs), Curve::Arc(ours)) => arc_error_m(theirs, ours)?,
        (None, Curve::Straight(_) | Curve::Taper(_)) => 0.0,
        _ => return None,
    };
    let error_m = apart_m(theirs.start, ours.start_world)
        .max(apart_m(theirs.end, ours.end_world))
        .max((theirs.length - ours.length_m).abs())
        .max((theirs.width - ours.width_m).abs())
        .max(arc_m);
    let same = theirs.class == class && theirs.lines == lines && color == ours.left_color;
    same.then_some(error_m)
}

fn arc_error_m(theirs: &record::Arc, ours: &Arc) -> Option<f64> {
    let same = theirs.clockwise == (ours.turn == Turn::Right)
        && is_near_rad(theirs.start_phase, ours.start_phase_rad)
        && is_near_rad(theirs.angle, ours.angle_rad);
    let error_m = apart_m(theirs.center, ours.center_world);
    same.then(|| error_m.max((theirs.radius - ours.radius_m).abs()))
}

fn object_error(theirs: &record::Object, ours: &Obstacle) -> Option<f64> {
    let class = match ours.kind {
        ObstacleKind::Cone => "TrafficCone",
        ObstacleKind::Warning => "TrafficWarning",
        ObstacleKind::Barrier => "TrafficBarrier",
        ObstacleKind::BrokenDown(kind) => kind.model().name,
    };
    let same = theirs.cls == class && is_near_rad(theirs.heading, ours.heading_rad);
    same.then(|| apart_m(theirs.pos, ours.position_world))
}

fn car_error(network: &Network, theirs: &record::Car, ours: &Spawn) -> Option<f64> {
    let model = ours.kind.model();
    // The recording has no class for the ego car.
    let same_kind = theirs.cls.as_ref().is_none_or(|class| class == model.name);
    let Place {
        lane,
        position_world,
        heading_rad,
        longitudinal_m,
    } = ours.place;
    let (from, to, number) = &theirs.lane;
    let same_lane = format!("{from}|{to}|{number}") == lane_name(network, lane);
    // Forces are hundreds of newtons and recorded in single precision.
    let same_forces = (theirs.engine - ours.forces.engine_n).abs() < BAR_M
        && (theirs.brake - ours.forces.brake).abs() < BAR_M;
    let same_body = theirs.size.is_none_or(|[length_m, width_m]| {
        (length_m - model.length_m).abs() < BAR_M && (width_m - model.width_m).abs() < BAR_M
    }) && theirs.mass.is_none_or(|mass_kg| mass_kg == model.mass_kg);
    let along_m = theirs
        .long
        .map_or(0.0, |long_m| (long_m - longitudinal_m).abs());
    let same = same_kind
        && same_lane
        && same_forces
        && same_body
        && is_near_rad(theirs.heading, heading_rad);
    same.then(|| apart_m(theirs.pos, position_world).max(along_m))
}

fn apart_m([x, y]: [f64; 2], ours: Point) -> f64 {
    (x - ours.x).hypot(y - ours.y)
}

fn is_near_rad(theirs: f64, ours: f64) -> bool {
    let away = (theirs - ours).rem_euclid(TAU);
    away.min(TAU - away) <= BAR_M
}

fn nodes(network: &Network, route: &Route) -> Vec<String> {
    let name = |node: &NodeId| network.nodes()[node.index()].to_string();
    route.checkpoints(network).iter().map(name).collect()
}

fn lane_name(network: &Network, lane: LaneId) -> String {
    let road = network.road_name(network.road_of(lane));
    format!("{road}|{}", network.index_in_road(lane))
}
