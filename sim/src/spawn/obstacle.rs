//! Obstacles: a row of cones that closes a lane, a broken-down car behind its
//! warning triangle, or a barrier.

use super::{Obstacle, ObstacleKind, Streams};
use crate::map::{Block, BlockKind, Map};
use crate::model::VehicleKind;
use crate::rng::Stream;
use crate::road::{LaneId, Network};

/// Probabilities below this switch obstacles off altogether.
const NEGLIGIBLE: f64 = 1e-2;
/// Share of obstacles that are not cones (`PROHIBIT_SCENE_PROB`).
const NOT_CONES: f64 = 0.67;
/// Distance from the warning triangle to the car, m (`ALERT_DIST`).
const WARNING_M: f64 = 10.0;
/// Length closed by cones, m, and how far before the lane's end it stops.
const CLOSED_M: f64 = 10.0;
const CLOSED_BEFORE_END_M: f64 = 5.0;
/// Distance between cones along and across the lane, m.
const CONE_ALONG_M: f64 = 2.0;
const CONE_ACROSS_M: f64 = 1.0;

/// At which side of the road an obstacle stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Left,
    Right,
}

/// Places all obstacles; returns them and the lanes that they close.
pub(super) fn place(
    map: &Map,
    streams: &mut Streams,
    probability: f64,
) -> (Vec<Obstacle>, Vec<LaneId>) {
    let mut scene = Scene {
        map,
        obstacles: Vec::new(),
        closed_lanes: Vec::new(),
    };
    if probability < NEGLIGIBLE {
        return (scene.obstacles, scene.closed_lanes);
    }
    let mut own = Stream::new(map.seed);
    for block in &map.blocks {
        if !block.main_roads.is_empty() && own.unit() <= probability {
            scene.place_on(block, &mut own, streams);
        }
    }
    (scene.obstacles, scene.closed_lanes)
}

struct Scene<'a> {
    map: &'a Map,
    obstacles: Vec<Obstacle>,
    closed_lanes: Vec<LaneId>,
}

impl Scene<'_> {
    fn network(&self) -> &Network {
        &self.map.network
    }

    fn place_on(&mut self, block: &Block, own: &mut Stream, streams: &mut Streams) {
        let cones = own.unit() > NOT_CONES;
        // Cones stand on the straight road of a curve; everything else draws
        // between two roads, even where there is only one.
        let choice = match (cones, block.kind) {
            (true, BlockKind::Curve) => 1,
            _ => own.below(2) as usize,
        };
        let last = block.main_roads.len() - 1;
        let road = block.main_roads[choice.min(last)];
        let ramp = matches!(block.kind, BlockKind::InRamp | BlockKind::OutRamp);
        // The second road of a ramp is closed on the left, away from it.
        let side = match own.unit() > 0.5 || (ramp && choice == 1) {
            true => Side::Left,
            false => Side::Right,
        };
        let road = *self.network().road(road);
        if cones {
            let lane = match side {
                Side::Left => road.first_lane,
                Side::Right => road.last_lane(),
            };
            self.closed_lanes.push(lane);
            self.place_cones(lane, side, &mut streams.engine);
            return;
        }
        let inner_lanes = u32::from(road.lane_count) - 1;
        let lane = match side {
            Side::Left if inner_lanes > 0 => {
                LaneId(road.first_lane.0 + own.below(inner_lanes) as u16)
            }
            _ => road.last_lane(),
        };
        self.closed_lanes.push(lane);
        let half_m = self.network().lane(lane).length_m / 2.0;
        let longitudinal_m = own.unit() * half_m + half_m;
        if own.unit() > 0.5 {
            self.place_broken_down(lane, longitudinal_m, streams);
        } else {
            streams.engine.spawn_seed();
            self.put(ObstacleKind::Barrier, lane, (longitudinal_m, 0.0));
        }
    }

    fn place_broken_down(&mut self, lane: LaneId, longitudinal_m: f64, streams: &mut Streams) {
        let kind = draw_kind(&mut streams.traffic);
        streams.engine.spawn_seed();
        self.put(ObstacleKind::BrokenDown(kind), lane, (longitudinal_m, 0.0));
        streams.engine.spawn_seed();
        self.put(
            ObstacleKind::Warning,
            lane,
            (longitudinal_m - WARNING_M, 0.0),
        );
    }

    /// Cones slant in from the side of the road, run along the lane's inner
    /// edge, and slant out again.
    fn place_cones(&mut self, lane: LaneId, side: Side, engine: &mut Stream) {
        let width_m = self.network().lane(lane).width_m;
        let length_m = self.network().lane(lane).length_m;
        let middle_m = length_m - CLOSED_M - CLOSED_BEFORE_END_M;
        let across = (self.map.lane_width_m / CONE_ACROSS_M) as i32;
        let along = (CLOSED_M / CONE_ALONG_M) as i32;
        let slant_in = 0..across;
        let straight = (0..=along).map(|_| across);
        let slant_out = (0..across).rev();
        let half = (across * 2 + along + 1) / 2;
        let sign = match side {
            Side::Left => 1.0,
            Side::Right => -1.0,
        };
        let laterals = slant_in.chain(straight).chain(slant_out);
        for (step, lateral) in (-half..half).zip(laterals) {
            let longitudinal_m = f64::from(step) * CONE_ALONG_M + middle_m;
            let lateral_m = sign * (f64::from(lateral) * CONE_ACROSS_M - width_m / 2.0);
            engine.spawn_seed();
            self.put(ObstacleKind::Cone, lane, (longitudinal_m, lateral_m));
        }
    }

    fn put(&mut self, kind: ObstacleKind, lane: LaneId, (longitudinal_m, lateral_m): (f64, f64)) {
        let centerline = self.network().lane(lane);
        let obstacle = Obstacle {
            kind,
            lane,
            position_world: centerline.position(longitudinal_m, lateral_m),
            heading_rad: centerline.heading_at(longitudinal_m),
        };
        self.obstacles.push(obstacle);
    }
}

/// Draws what car it is from the traffic's stream.
pub(super) fn draw_kind(traffic: &mut Stream) -> VehicleKind {
    let weights = VehicleKind::TRAFFIC_WEIGHTS.map(|(_, weight)| weight);
    VehicleKind::TRAFFIC_WEIGHTS[traffic.weighted(&weights)].0
}
