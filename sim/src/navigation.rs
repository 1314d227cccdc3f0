//! Where a car is on its route: its lane, the road it is on and the next one,
//! and how much of the route it has driven.
//! Source: `component/navigation_module/node_network_navigation.py`.

use std::mem::offset_of;

use vehicle::{Point, Vector};

use crate::nearby::{Cell, Nearby, around};
use crate::prefetch;
use crate::road::{LaneId, Network, RoadId};
use crate::spawn::Route;

/// A road counts as reached while the lane coordinate on it is below this, m
/// (`CKPT_UPDATE_RANGE`).
const REACHED_M: f64 = 5.0;
/// How far outside a lane's convex shape a ray still hits it, m: Bullet's
/// margin of 0.04 and its tolerance of 0.01. With it, not one of 49,010
/// recorded ticks is localised differently; with 0.04 or 0.06 a dozen are.
const SURFACE_MARGIN_M: f64 = 0.05;

/// A car's progress along its route. What most ticks read is in the first two lines.
#[derive(Clone, Debug, PartialEq)]
#[repr(C)]
pub struct Navigator {
    /// The lanes whose boxes hold its place.
    cell: Cell,
    /// Where it was found, and its coordinates on the leftmost lane of the current
    /// road and on its own, m.
    position_world: Point,
    longitudinal_m: f64,
    lateral_m: f64,
    own_m: (f64, f64),
    /// Where it was found the time before, its lane, and the coordinate along it, m.
    before_world: Point,
    before_lane: LaneId,
    before_m: f64,
    travelled_m: f64,
    /// The road the car is on, the one after it, and the last one.
    road: RoadId,
    next_road: Option<RoadId>,
    final_road: RoadId,
    lane: LaneId,
    on_lane: bool,
    length_m: f64,
    /// Index of the road the car is on.
    current: usize,
    roads: Vec<RoadId>,
    /// The lanes around it.
    nearby: Nearby,
}

impl Navigator {
    /// At the beginning of a route, on one of its first road's lanes.
    pub fn new(network: &Network, route: &Route, lane: LaneId, position_world: Point) -> Navigator {
        let roads = route.roads.clone();
        let own_m = network.lane(lane).local_coordinates(position_world);
        let mut navigator = Navigator {
            cell: Cell::default(),
            position_world,
            longitudinal_m: 0.0,
            lateral_m: 0.0,
            own_m,
            before_world: position_world,
            before_lane: lane,
            before_m: own_m.0,
            travelled_m: 0.0,
            road: roads[0],
            next_road: None,
            final_road: roads[roads.len() - 1],
            lane,
            on_lane: true,
            length_m: route.length_m(network),
            current: 0,
            roads,
            nearby: Nearby::default(),
        };
        navigator.enter(0);
        navigator.refer(network, position_world);
        navigator.travelled_m = navigator.longitudinal_m;
        navigator
    }

    /// Asks for what an update reads of the navigator itself.
    pub(crate) fn prefetch(&self) {
        prefetch::first::<{ offset_of!(Navigator, roads) }, _>(self);
    }

    /// Asks for the lanes that an update reads while the car stays in its cell.
    pub(crate) fn prefetch_lanes(&self, network: &Network) {
        network.prefetch_lane(self.lane);
        for &lane in self.cell.of(self.position_world).unwrap_or_default() {
            network.prefetch_lane(LaneId(lane));
        }
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
        self.road
    }

    /// The road after it; `None` on the last one.
    pub fn next_road(&self) -> Option<RoadId> {
        self.next_road
    }

    /// The last road.
    pub fn final_road(&self) -> RoadId {
        self.final_road
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
        (self.before_world, self.before_lane) = (self.position_world, self.lane);
        self.before_m = self.own_m.0;
        match self.localize(network, position_world, forward_world) {
            Some(found) => (self.lane, self.own_m) = found,
            None => self.own_m = network.lane(self.lane).local_coordinates(position_world),
        }
        let before_m = self.longitudinal_m;
        self.refer(network, position_world);
        self.travelled_m += self.longitudinal_m - before_m;
        if self.own_m.0 >= REACHED_M {
            return;
        }
        let from = network.road(network.road_of(self.lane)).from;
        let ahead = self.roads[self.current..].iter().skip(1);
        if let Some(passed) = ahead
            .map(|&road| network.road(road).from)
            .position(|node| node == from)
        {
            self.enter(self.current + passed + 1);
            self.refer(network, position_world);
        }
    }

    /// Notes that the car is on a road of its route.
    fn enter(&mut self, index: usize) {
        self.current = index;
        self.road = self.roads[index];
        self.next_road = self.roads.get(index + 1).copied();
    }

    /// Of the lanes under the car whose direction it shares, the nearest of
    /// the current road, else of the next, else of any; with the car's coordinates on it, m.
    fn localize(
        &mut self,
        network: &Network,
        position_world: Point,
        forward_world: Vector,
    ) -> Option<(LaneId, (f64, f64))> {
        if self.cell.of(position_world).is_none() {
            self.find_cell(network, position_world);
        }
        let held = self.cell.of(position_world);
        let count = held.map_or(network.lanes().len(), <[u16]>::len);
        let mut on_lane = false;
        let mut best: Option<(u8, f64, LaneId, (f64, f64))> = None;
        for place in 0..count {
            let id = LaneId(held.map_or(place as u16, |lanes| lanes[place]));
            if held.is_none()
                && !network.bounds()[id.index()].contains(position_world, SURFACE_MARGIN_M)
            {
                continue;
            }
            let lane = network.lane(id);
            if !lane.surface_contains(position_world, SURFACE_MARGIN_M) {
                continue;
            }
            on_lane = true;
            let (longitudinal_m, lateral_m) = lane.local_coordinates(position_world);
            if lane.forward_at(longitudinal_m).dot(&forward_world) <= 0.0 {
                continue;
            }
            let road = network.road_of(id);
            let rank = match () {
                () if road == self.road => 0,
                () if Some(road) == self.next_road => 1,
                () => 2,
            };
            let distance_m = lateral_m.abs()
                + (longitudinal_m - lane.length_m).max(0.0)
                + (-longitudinal_m).max(0.0);
            if best.is_none_or(|(r, d, ..)| (rank, distance_m) < (r, d)) {
                best = Some((rank, distance_m, id, (longitudinal_m, lateral_m)));
            }
        }
        self.on_lane = on_lane;
        best.map(|(_, _, id, own_m)| (id, own_m))
    }

    /// Finds the cell of a place. Where too many lanes are near, there is none.
    fn find_cell(&mut self, network: &Network, position_world: Point) {
        // Twice the margin, so that rounding leaves out no lane.
        let asked = around(position_world, 2.0 * SURFACE_MARGIN_M);
        self.cell = Cell::default();
        let bounds = network.bounds();
        let Some((lanes, listed)) = self.nearby.find(&asked, bounds.iter()) else {
            return;
        };
        let near = lanes.iter().map(|&lane| (lane, bounds[usize::from(lane)]));
        let within = listed.shrunk(2.0 * SURFACE_MARGIN_M);
        self.cell
            .find(position_world, SURFACE_MARGIN_M, within, near);
    }

    /// Coordinates of a place on a lane, m; known already where the car was found, on its
    /// own lane and on the leftmost one of the current road.
    pub(crate) fn coordinates(
        &self,
        network: &Network,
        lane: LaneId,
        position_world: Point,
    ) -> (f64, f64) {
        let is_here = position_world == self.position_world;
        if is_here && lane == self.lane {
            self.own_m
        } else if is_here && lane == network.road(self.road).first_lane {
            (self.longitudinal_m, self.lateral_m)
        } else {
            network.lane(lane).local_coordinates(position_world)
        }
    }

    /// Coordinate along a lane where the car was found the time before, m.
    pub(crate) fn before_m(&self, network: &Network, lane: LaneId) -> f64 {
        match lane == self.before_lane {
            true => self.before_m,
            false => network.lane(lane).local_coordinates(self.before_world).0,
        }
    }

    /// How far the car has moved since it was found the time before, m.
    pub(crate) fn moved_m(&self) -> f64 {
        (self.position_world - self.before_world).norm()
    }

    fn refer(&mut self, network: &Network, position_world: Point) {
        self.position_world = position_world;
        let leftmost = network.lane(network.road(self.road).first_lane);
        (self.longitudinal_m, self.lateral_m) = leftmost.local_coordinates(position_world);
    }
}
