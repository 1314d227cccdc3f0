//! Traffic that waits on each block until the ego comes near it.

use super::obstacle::draw_kind;
use super::{Goals, Place, Spawn, Streams, TrafficGroup, TrafficSpawn, sample_forces};
use crate::map::{Block, Map};
use crate::rng::Stream;
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
        let groups = self.map.blocks.iter().filter_map(|block| {
            Some(TrafficGroup {
                trigger: block.entry?.positive,
                cars: self.place_on(block, streams),
            })
        });
        groups.collect()
    }

    fn place_on(&self, block: &Block, streams: &mut Streams) -> Vec<TrafficSpawn> {
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
        let cars = places.into_iter();
        cars.map(|place| self.place_car(place, streams)).collect()
    }

    fn place_car(&self, place: (LaneId, f64), streams: &mut Streams) -> TrafficSpawn {
        let (lane, longitudinal_m) = place;
        let kind = draw_kind(&mut streams.traffic);
        let forces = sample_forces(kind, &mut streams.engine);
        let mut policy = Stream::new(streams.traffic.spawn_seed());
        TrafficSpawn {
            car: Spawn {
                kind,
                place: Place::new(&self.map.network, lane, longitudinal_m),
                forces,
                route: self.goals.route(&self.map.network, lane),
            },
            overtake_timer: policy.below(LANE_CHANGE_STEPS),
        }
    }
}
