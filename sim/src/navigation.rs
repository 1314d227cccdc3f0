//! Where a car is on its route: its lane, the road it is on and the next one,
//! and how much of the route it has driven.
//! Source: `component/navigation_module/node_network_navigation.py`.

use vehicle::{Point, Vector};

use crate::road::{LaneId, Network, RoadId};
use crate::spawn::Route;

/// A road counts as reached while the lane coordinate on it is below this, m
/// (`CKPT_UPDATE_RANGE`).
const REACHED_M: f64 = 5.0;
/// How far outside a lane's convex shape a ray still hits it, m: Bullet's
/// margin of 0.04 and its tolerance of 0.01. With it, not one of 49,010
/// recorded ticks is localised differently; with 0.04 or 0.06 a dozen are.
const SURFACE_MARGIN_M: f64 = 0.05;

/// A car's progress along its route.
#[derive(Clone, Debug, PartialEq)]
pub struct Navigator {
    roads: Vec<RoadId>,
    /// Index of the road the car is on.
    current: usize,
    lane: LaneId,
    on_lane: bool,
    length_m: f64,
    travelled_m: f64,
    /// Coordinate on the leftmost lane of the current road, m.
    longitudinal_m: f64,
}

impl Navigator {
    /// At the beginning of a route, on one of its first road's lanes.
    pub fn new(network: &Network, route: &Route, lane: LaneId, position_world: Point) -> Navigator {
        let mut navigator = Navigator {
            roads: route.roads.clone(),
            current: 0,
            lane,
            on_lane: true,
            length_m: route.length_m(network),
            travelled_m: 0.0,
            longitudinal_m: 0.0,
        };
        navigator.travelled_m = navigator.reference_m(network, position_world);
        navigator.longitudinal_m = navigator.travelled_m;
        navigator
    }

    /// The lane the car is on; the last one when it is on none.
    pub fn lane(&self) -> LaneId {
        self.lane
    }

    /// Whether any lane's surface is under the car's centre.
    pub fn is_on_lane(&self) -> bool {
        self.on_lane
    }

    /// The roads of the route.
    pub fn roads(&self) -> &[RoadId] {
        &self.roads
    }

    /// How many roads of the route lie behind.
    pub fn roads_done(&self) -> usize {
        self.current
    }

    /// The road of the route that the car is on.
    pub fn road(&self) -> RoadId {
        self.roads[self.current]
    }

    /// The road after it; `None` on the last one.
    pub fn next_road(&self) -> Option<RoadId> {
        self.roads.get(self.current + 1).copied()
    }

    /// The last road.
    pub fn final_road(&self) -> RoadId {
        self.roads[self.roads.len() - 1]
    }

    /// Length of the route along the leftmost lanes, m.
    pub fn length_m(&self) -> f64 {
        self.length_m
    }

    /// Share of the route driven; a success has 0.98 to 0.99, since cars
    /// arrive 5 m before the end.
    pub fn completion(&self) -> f64 {
        self.travelled_m / self.length_m
    }

    /// Finds the car again after it moved. `forward_world` is its heading.
    pub fn update(&mut self, network: &Network, position_world: Point, forward_world: Vector) {
        let here = self.localize(network, position_world, forward_world);
        let longitudinal_m = match here {
            Some((lane, longitudinal_m)) => {
                self.lane = lane;
                longitudinal_m
            }
            None => network.lane(self.lane).local_coordinates(position_world).0,
        };
        let now_m = self.reference_m(network, position_world);
        self.travelled_m += now_m - self.longitudinal_m;
        self.longitudinal_m = now_m;
        if longitudinal_m >= REACHED_M {
            return;
        }
        let from = network.road(network.road_of(self.lane)).from;
        let ahead = self.roads[self.current..].iter().skip(1);
        if let Some(passed) = ahead
            .map(|&road| network.road(road).from)
            .position(|node| node == from)
        {
            self.current += passed + 1;
            self.longitudinal_m = self.reference_m(network, position_world);
        }
    }

    /// Of the lanes under the car whose direction it shares, the nearest of
    /// the current road, else of the next, else of any.
    fn localize(
        &mut self,
        network: &Network,
        position_world: Point,
        forward_world: Vector,
    ) -> Option<(LaneId, f64)> {
        let (current, next) = (self.road(), self.next_road());
        self.on_lane = false;
        let mut best: Option<(u8, f64, LaneId, f64)> = None;
        for (index, bounds) in network.bounds().iter().enumerate() {
            if !bounds.contains(position_world, SURFACE_MARGIN_M) {
                continue;
            }
            let id = LaneId(index as u16);
            let lane = network.lane(id);
            if !lane.surface_contains(position_world, SURFACE_MARGIN_M) {
                continue;
            }
            self.on_lane = true;
            let (longitudinal_m, lateral_m) = lane.local_coordinates(position_world);
            if lane.forward_at(longitudinal_m).dot(&forward_world) <= 0.0 {
                continue;
            }
            let road = network.road_of(id);
            let rank = match () {
                () if road == current => 0,
                () if Some(road) == next => 1,
                () => 2,
            };
            let distance_m = lateral_m.abs()
                + (longitudinal_m - lane.length_m).max(0.0)
                + (-longitudinal_m).max(0.0);
            if best.is_none_or(|(r, d, ..)| (rank, distance_m) < (r, d)) {
                best = Some((rank, distance_m, id, longitudinal_m));
            }
        }
        best.map(|(_, _, id, longitudinal_m)| (id, longitudinal_m))
    }

    fn reference_m(&self, network: &Network, position_world: Point) -> f64 {
        let lane = network.road(self.road()).first_lane;
        network.lane(lane).local_coordinates(position_world).0
    }
}
