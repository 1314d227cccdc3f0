//! The other cars: parked until the ego comes near, then driven by the intelligent
//! driver model, and removed when they leave the road. Source:
//! `manager/traffic_manager.py`, trigger mode.

use vehicle::pose;

use crate::bodies::{Bodies, Mover};
use crate::dynamics::{Car, Motion};
use crate::idm::{Idm, Neighbour, View};
use crate::model::{Forces, VehicleKind};
use crate::navigation::Navigator;
use crate::road::{LaneId, Network, RoadId};
use crate::spawn::{Obstacle, ObstacleKind, Scenario, Spawn};

/// All kinds of car, by the number of the enumeration.
const KINDS: [VehicleKind; 5] = [
    VehicleKind::Default,
    VehicleKind::Small,
    VehicleKind::Medium,
    VehicleKind::Large,
    VehicleKind::ExtraLarge,
];

/// What drives a car of the traffic.
#[derive(Clone, Debug)]
enum Mind {
    /// Nothing: it has broken down on this lane.
    Broken(LaneId),
    /// A driver, which waits for its group's trigger or drives.
    Driver {
        group: usize,
        navigator: Navigator,
        idm: Idm,
    },
}

/// What drives each mover except the ego, in the movers' order.
#[derive(Clone, Debug)]
pub struct Traffic {
    minds: Vec<Mind>,
    /// The road that starts each group, in order.
    triggers: Vec<RoadId>,
    started: usize,
    neighbours: Vec<Neighbour>,
    /// The index of each mover among the neighbours.
    places: Vec<usize>,
    /// Each kind of car at rest on its springs.
    settled: [Motion; 5],
}

impl Default for Traffic {
    fn default() -> Traffic {
        Traffic::new()
    }
}

impl Traffic {
    /// No cars yet.
    pub fn new() -> Traffic {
        let settled = KINDS.map(|kind| {
            let forces = Forces {
                engine_n: 0.0,
                brake: 0.0,
            };
            Motion::settled(pose(0.0, 0.0, 0.0), &Car::new(kind, forces))
        });
        Traffic {
            minds: Vec::new(),
            triggers: Vec::new(),
            started: 0,
            neighbours: Vec::new(),
            places: Vec::new(),
            settled,
        }
    }

    /// Adds the scenario's cars after the ego, which is the first mover; the fixtures
    /// are already there.
    pub fn place(&mut self, scenario: &Scenario, bodies: &mut Bodies) {
        self.minds.clear();
        self.triggers.clear();
        self.started = 0;
        for obstacle in &scenario.obstacles {
            if let ObstacleKind::BrokenDown(kind) = obstacle.kind {
                bodies.movers.push(self.broken_down(kind, obstacle));
                self.minds.push(Mind::Broken(obstacle.lane));
            }
        }
        let network = &scenario.map.network;
        for (group, cars) in scenario.traffic.iter().enumerate() {
            self.triggers.push(cars.trigger);
            for spawn in &cars.cars {
                let Spawn {
                    kind,
                    place,
                    forces,
                    ..
                } = spawn.car;
                let position = place.position_world;
                let at = pose(position.x, position.y, place.heading_rad);
                let motion = self.settled[kind as usize].moved_to(at);
                let mut navigator = Navigator::new(network, &spawn.car.route, place.lane, position);
                navigator.update(network, position, motion.seen_forward());
                let seed = scenario.map.seed.rotate_left(32) ^ self.minds.len() as u64;
                bodies
                    .movers
                    .push(Mover::new(kind, Car::new(kind, forces), motion));
                self.minds.push(Mind::Driver {
                    group,
                    navigator,
                    idm: Idm::new(spawn.overtake_timer, seed),
                });
            }
        }
        self.reserve(bodies);
    }

    /// Reserves memory for the bodies that [`Traffic::look`] lists, so that no tick
    /// allocates when the first group starts.
    fn reserve(&mut self, bodies: &Bodies) {
        let movers = bodies.movers.len();
        self.neighbours.clear();
        self.neighbours
            .reserve_exact(movers + bodies.fixtures.len());
        self.places.clear();
        self.places.reserve_exact(movers);
    }

    /// It has no driver, so its engine does not matter; it rolls when it is hit.
    fn broken_down(&self, kind: VehicleKind, obstacle: &Obstacle) -> Mover {
        let position = obstacle.position_world;
        let at = pose(position.x, position.y, obstacle.heading_rad);
        let forces = Forces {
            engine_n: 0.0,
            brake: 0.0,
        };
        let motion = self.settled[kind as usize].moved_to(at);
        Mover::new(kind, Car::new(kind, forces), motion)
    }

    /// Starts the next group when the ego is on its road.
    pub fn trigger(&mut self, ego_road: RoadId) {
        if self.triggers.get(self.started) == Some(&ego_road) {
            self.started += 1;
        }
    }

    /// Whether the car of a mover is being driven.
    pub fn is_driving(&self, mover: usize) -> bool {
        let mind = mover.checked_sub(1).and_then(|index| self.minds.get(index));
        matches!(mind, Some(Mind::Driver { group, .. }) if *group < self.started)
    }

    /// Whether the car of a mover has broken down.
    pub fn is_broken_down(&self, mover: usize) -> bool {
        let mind = mover.checked_sub(1).and_then(|index| self.minds.get(index));
        matches!(mind, Some(Mind::Broken(_)))
    }

    /// What drivers see of all bodies; the ego is the first.
    pub fn look(&mut self, bodies: &Bodies, ego_lane: LaneId) -> &[Neighbour] {
        let Traffic {
            minds,
            neighbours,
            places,
            ..
        } = self;
        neighbours.clear();
        places.clear();
        let lanes = minds.iter().map(|mind| match mind {
            Mind::Broken(lane) => *lane,
            Mind::Driver { navigator, .. } => navigator.lane(),
        });
        for (mover, lane) in bodies
            .movers
            .iter()
            .zip(std::iter::once(ego_lane).chain(lanes))
        {
            places.push(neighbours.len());
            if mover.present {
                neighbours.push(Neighbour {
                    lane,
                    position_world: mover.motion.seen_position(),
                    velocity_world: mover.motion.velocity_world(),
                    forward_world: mover.motion.seen_forward(),
                });
            }
        }
        neighbours.extend(bodies.fixtures.iter().map(|fixture| Neighbour {
            lane: fixture.lane,
            position_world: fixture.placed.center_world,
            velocity_world: vehicle::Vector::zeros(),
            forward_world: fixture.placed.forward_world,
        }));
        neighbours
    }

    /// Lets all drivers decide whose group has started.
    pub fn drive(&mut self, network: &Network, bodies: &mut Bodies, ego_lane: LaneId) {
        if !(1..bodies.movers.len()).any(|k| bodies.movers[k].present && self.is_driving(k)) {
            return;
        }
        self.look(bodies, ego_lane);
        let started = self.started;
        for ((mind, mover), &own) in self
            .minds
            .iter_mut()
            .zip(&mut bodies.movers[1..])
            .zip(&self.places[1..])
        {
            let Mind::Driver {
                group,
                navigator,
                idm,
            } = mind
            else {
                continue;
            };
            if *group < started && mover.present {
                let view = View {
                    network,
                    navigator,
                    bodies: &self.neighbours,
                    own,
                };
                mover.command(idm.act(&view));
            }
        }
    }

    /// Localises the driven cars after they moved, and removes those that left the
    /// road.
    pub fn follow(&mut self, network: &Network, bodies: &mut Bodies) {
        let started = self.started;
        for (mind, mover) in self.minds.iter_mut().zip(&mut bodies.movers[1..]) {
            if let Mind::Driver {
                group, navigator, ..
            } = mind
                && *group < started
                && mover.present
            {
                let motion = &mover.motion;
                navigator.update(network, motion.seen_position(), motion.seen_forward());
                mover.present = navigator.is_on_lane();
                mover.awake &= mover.present;
            }
        }
    }
}
