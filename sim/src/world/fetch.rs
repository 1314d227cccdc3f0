//! What a batch fetches of its next worlds while one moves.

use std::mem::offset_of;

use shm_config::message::Observation;

use super::World;
use crate::bodies::Mover;
use crate::prefetch;
use crate::road::RoadId;

/// Bytes from the outcome on that a tick reads of a world itself.
const HOT_BYTES: usize = offset_of!(World, sidewalks) - offset_of!(World, step);

impl World {
    /// Asks for what the next worlds of a round read in their tick; to be called before
    /// each tick. `world` returns the world of an index, or `None` after the last one. Each
    /// world has begun an episode.
    pub fn prefetch_after<'a>(index: usize, world: impl Fn(usize) -> Option<&'a World>) {
        if let Some(world) = world(index + 3) {
            world.prefetch();
        }
        if let Some(world) = world(index + 2) {
            world.prefetch_arrays();
        }
        if let Some(world) = world(index + 1) {
            world.prefetch_cars();
        }
    }

    /// Asks for what [`World::observe`] writes.
    pub(crate) fn prefetch_observation(&self, observation: &Observation) {
        let ranges_m = &observation.ranges_m;
        prefetch::first::<{ offset_of!(Observation, ranges_m) }, _>(observation);
        let beams = self.config.scanner.beams as usize;
        prefetch::slice(&ranges_m[..beams.min(ranges_m.len())]);
    }

    /// Asks for what a tick reads of the world itself: the first of three steps, each of
    /// which needs what the one before has asked for.
    fn prefetch(&self) {
        self.navigator.prefetch();
        prefetch::first::<HOT_BYTES, _>(&self.step);
    }

    /// Asks for the arrays; the second step.
    fn prefetch_arrays(&self) {
        self.bodies.prefetch();
        self.traffic.prefetch();
        let network = &self.map.network;
        self.navigator.prefetch_lanes(network);
        for road in self.roads_ahead() {
            network.prefetch_road(road);
        }
    }

    /// Asks for what the arrays refer to; the third step.
    fn prefetch_cars(&self) {
        for index in self.bodies.awake() {
            prefetch::first::<{ size_of::<Mover>() }, _>(&self.bodies.movers[index]);
        }
        let network = &self.map.network;
        self.traffic.prefetch_lanes(network, &self.bodies);
        for road in self.roads_ahead() {
            let road = network.road(road);
            network.prefetch_lane(road.first_lane);
            network.prefetch_lane(road.last_lane());
        }
    }

    /// The roads of which the ego's observation and the rules speak.
    fn roads_ahead(&self) -> impl Iterator<Item = RoadId> + use<> {
        let here = self.navigator.road();
        let next = self.navigator.next_road().unwrap_or(here);
        [here, next, self.navigator.final_road()].into_iter()
    }
}
