//! Traffic that waits on each block until the ego comes near it.

use super::obstacle::draw_kind;
use super::{Goals, Place, Spawn, Streams, TrafficGroup, TrafficSpawn};
use crate::map::{Block, Map};
use crate::model::VehicleKind;
use crate::rng::{Stream, parameters_of};
use crate::road::LaneId;

/// Densities below this switch traffic off altogether.
const NEGLIGIBLE: f64 = 1e-2;
/// Distance between two places for a car on a lane, m (`VEHICLE_GAP`).
const GAP_M: f64 = 10.0;
/// Cars may change lanes once in so many steps (`LANE_CHANGE_FREQ`); their
/// timers begin anywhere below it.
const LANE_CHANGE_STEPS: u32 = 50;

/// Everything that placing traffic depends on.
pub(super) struct Placement<'a> {
    pub map: &'a Map,
    pub goals: &'a Goals,
    pub closed_lanes: &'a [LaneId],
    pub density: f64,
}

impl Placement<'_> {
    pub fn place(&self, streams: &mut Streams) -> Vec<TrafficGroup> {
        if self.density < NEGLIGIBLE {
            return Vec::new();
        }
        let (mut groups, mut drawn) = (Vec::new(), Vec::new());
        for block in &self.map.blocks {
            let Some(entry) = block.entry else {
                continue;
            };
            let places = self.places_on(block, streams);
            groups.push((entry.positive, places.len()));
            drawn.extend(places.into_iter().map(|place| Drawn::draw(place, streams)));
        }
        let mut cars = self.cars(&drawn);
        let group = |(trigger, count)| TrafficGroup {
            trigger,
            cars: cars.by_ref().take(count).collect(),
        };
        groups.into_iter().map(group).collect()
    }

    /// Where cars stand on the roads of a block.
    fn places_on(&self, block: &Block, streams: &mut Streams) -> Vec<(LaneId, f64)> {
        let network = &self.map.network;
        let roads = block.traffic_roads.iter();
        let lanes: Vec<LaneId> = roads.flat_map(|&road| network.lane_ids(road)).collect();
        let mut places: Vec<(LaneId, f64)> = Vec::new();
        let mut total_m = 0.0;
        for &lane in &lanes {
            let length_m = network.lane(lane).length_m;
            total_m += length_m;
            if !self.closed_lanes.contains(&lane) {
                let count = (length_m / GAP_M) as u32;
                places.extend((0..count).map(|i| (lane, f64::from(i) * GAP_M)));
            }
        }
        let count = ((total_m / GAP_M).floor() * self.density).floor() as usize;
        streams.traffic.shuffle(&mut places);
        places.truncate(count);
        places
    }

    /// The cars, from streams of their own, all of which are made at once.
    fn cars(&self, drawn: &[Drawn]) -> impl Iterator<Item = TrafficSpawn> {
        let seeds = |of: fn(&Drawn) -> u64| drawn.iter().map(of).collect::<Vec<u64>>();
        let shared = parameters_of(&mut Stream::many(&seeds(|car| car.own_seed)));
        let policies = Stream::many(&seeds(|car| car.policy_seed));
        let cars = drawn.iter().zip(shared).zip(policies);
        cars.map(move |((car, shared), mut policy)| {
            let (lane, longitudinal_m) = car.place;
            TrafficSpawn {
                car: Spawn {
                    kind: car.kind,
                    place: Place::new(&self.map.network, lane, longitudinal_m),
                    forces: car.kind.forces(shared),
                    route: self.goals.route(&self.map.network, lane),
                },
                overtake_timer: policy.below(LANE_CHANGE_STEPS),
            }
        })
    }
}

/// What the scene's streams say of a car.
struct Drawn {
    place: (LaneId, f64),
    kind: VehicleKind,
    /// Seeds of the car's own stream and of its driver's.
    own_seed: u64,
    policy_seed: u64,
}

impl Drawn {
    fn draw(place: (LaneId, f64), streams: &mut Streams) -> Drawn {
        Drawn {
            place,
            kind: draw_kind(&mut streams.traffic),
            own_seed: streams.engine.spawn_seed(),
            policy_seed: streams.traffic.spawn_seed(),
        }
    }
}
