//! The other cars: parked until the ego comes near, then driven by the intelligent
//! driver model, and removed when they leave the road. Source:
//! `manager/traffic_manager.py`, trigger mode.

use std::ops::Range;
use std::sync::LazyLock;

use vehicle::{Vector, pose};

use crate::bodies::{Bodies, Mover};
use crate::dynamics::{Car, Motion};
use crate::idm::{Idm, Neighbour, View};
use crate::model::{Forces, VehicleKind};
use crate::navigation::Navigator;
use crate::prefetch;
use crate::road::{LaneId, Network, RoadId};
use crate::spawn::{Obstacle, ObstacleKind, Scenario, Spawn};

/// What drives a car of the traffic.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "most are drivers, and a box would scatter them"
)]
enum Mind {
    /// Nothing: it has broken down on this lane.
    Broken(LaneId),
    /// A driver, which waits for its group's trigger or drives.
    Driver { navigator: Navigator, idm: Idm },
}

/// What drives each mover except the ego, in the movers' order.
#[derive(Clone, Debug)]
pub struct Traffic {
    minds: Vec<Mind>,
    /// Minds before those of the first group: cars that have broken down.
    broken_count: usize,
    /// The road that starts each group, in order, and where the group's minds end.
    groups: Vec<(RoadId, usize)>,
    started: usize,
    /// What drivers see of all bodies; of parked cars it is written once.
    neighbours: Vec<Neighbour>,
    /// The lane of each neighbour.
    lanes: Vec<LaneId>,
    /// The index of each mover among the neighbours.
    places: Vec<u16>,
    /// A car came or went, so the neighbours must be listed anew.
    is_stale: bool,
}

/// Each kind of car at rest on its springs. All worlds share them.
static SETTLED: LazyLock<[Motion; VehicleKind::ALL.len()]> = LazyLock::new(|| {
    VehicleKind::ALL.map(|kind| {
        let forces = Forces {
            engine_n: 0.0,
            brake: 0.0,
        };
        Motion::settled(pose(0.0, 0.0, 0.0), &Car::new(kind, forces))
    })
});

impl Default for Traffic {
    fn default() -> Traffic {
        Traffic::new()
    }
}

impl Traffic {
    /// No cars yet.
    pub fn new() -> Traffic {
        Traffic {
            minds: Vec::new(),
            broken_count: 0,
            groups: Vec::new(),
            started: 0,
            neighbours: Vec::new(),
            lanes: Vec::new(),
            places: Vec::new(),
            is_stale: true,
        }
    }

    /// Adds the scenario's cars after the ego, which is the first mover; the fixtures
    /// are already there.
    pub fn place(&mut self, scenario: &Scenario, bodies: &mut Bodies) {
        self.minds.clear();
        self.groups.clear();
        (self.started, self.is_stale) = (0, true);
        for obstacle in &scenario.obstacles {
            if let ObstacleKind::BrokenDown(kind) = obstacle.kind {
                bodies.push(Traffic::broken_down(kind, obstacle));
                self.minds.push(Mind::Broken(obstacle.lane));
            }
        }
        self.broken_count = self.minds.len();
        let network = &scenario.map.network;
        for cars in &scenario.traffic {
            for spawn in &cars.cars {
                let Spawn {
                    kind,
                    place,
                    forces,
                    ..
                } = spawn.car;
                let position = place.position_world;
                let at = pose(position.x, position.y, place.heading_rad);
                let motion = SETTLED[kind as usize].moved_to(at);
                let mut navigator = Navigator::new(network, &spawn.car.route, place.lane, position);
                navigator.update(network, position, motion.seen_forward());
                let seed = scenario.map.seed.rotate_left(32) ^ self.minds.len() as u64;
                bodies.push(Mover::new(kind, Car::new(kind, forces), motion));
                self.minds.push(Mind::Driver {
                    navigator,
                    idm: Idm::new(spawn.overtake_timer, seed).at_kmh(scenario.traffic_kmh),
                });
            }
            self.groups.push((cars.trigger, self.minds.len()));
        }
        self.reserve(bodies);
    }

    /// Reserves memory for the bodies that [`Traffic::look`] lists, so that no tick
    /// allocates when the first group starts.
    fn reserve(&mut self, bodies: &Bodies) {
        let movers = bodies.movers.len();
        let most = movers + bodies.fixtures.len();
        self.neighbours.clear();
        self.neighbours.reserve_exact(most);
        self.lanes.clear();
        self.lanes.reserve_exact(most);
        self.places.clear();
        self.places.reserve_exact(movers);
    }

    /// It has no driver, so its engine does not matter; it rolls when it is hit.
    fn broken_down(kind: VehicleKind, obstacle: &Obstacle) -> Mover {
        let position = obstacle.position_world;
        let at = pose(position.x, position.y, obstacle.heading_rad);
        let forces = Forces {
            engine_n: 0.0,
            brake: 0.0,
        };
        let motion = SETTLED[kind as usize].moved_to(at);
        Mover::new(kind, Car::new(kind, forces), motion)
    }

    /// Asks for what a tick reads of the drivers.
    pub(crate) fn prefetch(&self) {
        prefetch::slice(&self.lanes);
        prefetch::slice(&self.places);
        for mind in &self.minds[self.started()] {
            if let Mind::Driver { navigator, idm } = mind {
                navigator.prefetch();
                prefetch::value(idm);
            }
        }
        if let Some(next) = self.groups.get(self.started) {
            prefetch::value(next);
        }
    }

    /// Asks for what the drivers read of their lanes; after [`Traffic::prefetch`].
    pub(crate) fn prefetch_lanes(&self, network: &Network, bodies: &Bodies) {
        for mind in self.started() {
            if let Mind::Driver { navigator, .. } = &self.minds[mind]
                && bodies.spots[mind + 1].present
            {
                navigator.prefetch_lanes(network);
                let place = self.places.get(mind + 1).map(|&place| usize::from(place));
                if let Some(neighbour) = place.and_then(|place| self.neighbours.get(place)) {
                    prefetch::value(neighbour);
                }
            }
        }
    }

    /// Starts the next group when the ego is on its road.
    pub fn trigger(&mut self, ego_road: RoadId) {
        let next = self.groups.get(self.started);
        if next.is_some_and(|(trigger, _)| *trigger == ego_road) {
            self.started += 1;
        }
    }

    /// The minds of the groups that have started.
    fn started(&self) -> Range<usize> {
        match self.started.checked_sub(1) {
            Some(last) => self.broken_count..self.groups[last].1,
            None => 0..0,
        }
    }

    /// Whether the car of a mover is being driven.
    pub fn is_driving(&self, mover: usize) -> bool {
        mover
            .checked_sub(1)
            .is_some_and(|mind| self.started().contains(&mind))
    }

    /// Whether the car of a mover has broken down.
    pub fn is_broken_down(&self, mover: usize) -> bool {
        (1..=self.broken_count).contains(&mover)
    }

    /// What drivers see of all bodies; the ego is the first.
    pub fn look(&mut self, bodies: &Bodies, ego_lane: LaneId) -> (&[Neighbour], &[LaneId]) {
        if self.is_stale {
            self.list(bodies, ego_lane);
        } else {
            // Parked cars are as they were.
            for index in bodies.awake() {
                let lane = self.lane_of(index, ego_lane);
                let place = usize::from(self.places[index]);
                self.neighbours[place] = neighbour(&bodies.movers[index]);
                self.lanes[place] = lane;
            }
        }
        (&self.neighbours, &self.lanes)
    }

    /// Lists all bodies.
    fn list(&mut self, bodies: &Bodies, ego_lane: LaneId) {
        self.neighbours.clear();
        self.lanes.clear();
        self.places.clear();
        for (index, (mover, spot)) in bodies.movers.iter().zip(&bodies.spots).enumerate() {
            self.places.push(self.neighbours.len() as u16);
            if spot.present {
                let lane = self.lane_of(index, ego_lane);
                self.neighbours.push(neighbour(mover));
                self.lanes.push(lane);
            }
        }
        let fixtures = bodies.fixtures.iter().map(|fixture| Neighbour {
            position_world: fixture.placed.center_world,
            velocity_world: Vector::zeros(),
            forward_world: fixture.placed.forward_world,
        });
        self.neighbours.extend(fixtures);
        let lanes = bodies.fixtures.iter().map(|fixture| fixture.lane);
        self.lanes.extend(lanes);
        self.is_stale = false;
    }

    /// The lane of a mover.
    fn lane_of(&self, mover: usize, ego_lane: LaneId) -> LaneId {
        match mover.checked_sub(1).map(|mind| &self.minds[mind]) {
            None => ego_lane,
            Some(Mind::Broken(lane)) => *lane,
            Some(Mind::Driver { navigator, .. }) => navigator.lane(),
        }
    }

    /// Lets all drivers decide whose group has started.
    pub fn drive(&mut self, network: &Network, bodies: &mut Bodies, ego_lane: LaneId) {
        let started = self.started();
        if !started.clone().any(|mind| bodies.spots[mind + 1].present) {
            return;
        }
        self.look(bodies, ego_lane);
        for mind in started {
            let mover = mind + 1;
            if let Mind::Driver { navigator, idm } = &mut self.minds[mind]
                && bodies.spots[mover].present
            {
                let view = View {
                    network,
                    navigator,
                    bodies: &self.neighbours,
                    lanes: &self.lanes,
                    own: usize::from(self.places[mover]),
                };
                bodies.command(mover, idm.act(&view));
            }
        }
    }

    /// Localises the driven cars after they moved, and removes those that left the
    /// road.
    pub fn follow(&mut self, network: &Network, bodies: &mut Bodies) {
        for mind in self.started() {
            let mover = mind + 1;
            if let Mind::Driver { navigator, .. } = &mut self.minds[mind]
                && bodies.spots[mover].present
            {
                let motion = &bodies.movers[mover].motion;
                navigator.update(network, motion.seen_position(), motion.seen_forward());
                if !navigator.is_on_lane() {
                    bodies.remove(mover);
                    self.is_stale = true;
                }
            }
        }
    }
}

/// What drivers see of a car.
fn neighbour(mover: &Mover) -> Neighbour {
    Neighbour {
        position_world: mover.motion.seen_position(),
        velocity_world: mover.motion.velocity_world(),
        forward_world: mover.motion.seen_forward(),
    }
}
