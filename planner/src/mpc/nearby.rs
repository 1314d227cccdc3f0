use vehicle::{Extent, Point, Pose, Sight};

use crate::mpc::body::Body;
use tracker::Sighting;

/// Most places that are remembered: the outlines within reach of a truck have a quarter.
const PLACES_MAX: usize = 512;
/// Places nearer to each other than this are one, m: a cell of the field across.
const APART_M: f64 = 0.25;
/// How far from the body's corners a place is remembered, m: more than a wide turn moves the
/// rear to the side.
const BESIDE_M: f64 = 3.0;

/// What rests beside the body where its scanner no longer looks: a car with a scanner on its
/// bumper passes with its side what it has seen ahead.
///
/// A place is kept until the scanner looks there again or the body has left it behind. A scan
/// of the full circle needs no memory, and gets none.
///
/// The safety check has none either: it judges a proposal by one observation, so that a
/// recorded step holds all that its verdict depends on. What is remembered only makes paths
/// wider.
#[derive(Debug, Default)]
pub(crate) struct Nearby {
    places_world: heapless::Vec<Point, PLACES_MAX>,
}

impl Nearby {
    /// Nothing was seen yet.
    pub(crate) fn forget(&mut self) {
        self.places_world.clear();
    }

    /// Takes a scan in.
    pub(crate) fn update(
        &mut self,
        world_from_body: &Pose,
        sight: &Sight,
        body: &Body,
        sightings: &[Sighting],
    ) {
        if sight.extent() == Extent::All {
            return self.forget();
        }
        let reach_m = body.half_length_m.hypot(body.half_width_m) + BESIDE_M;
        let body_from_world = world_from_body.inverse();
        self.places_world.retain(|place| {
            let place_body = body_from_world * place;
            place_body.coords.norm() < reach_m && !sight.covers(place_body, f64::INFINITY)
        });
        let near =
            |sighting: &&Sighting| !sighting.moves() && sighting.point_body.coords.norm() < reach_m;
        for sighting in sightings.iter().filter(near) {
            let place = world_from_body * sighting.point_body;
            let is_known = |known: &Point| (known - place).norm_squared() < APART_M * APART_M;
            if !self.places_world.iter().any(is_known) {
                // When there is no room left, what is already beside the body matters more.
                let _ = self.places_world.push(place);
            }
        }
    }

    /// The places, in the body frame of now.
    pub(crate) fn places_body(&self, world_from_body: &Pose) -> impl Iterator<Item = Point> {
        let body_from_world = world_from_body.inverse();
        self.places_world
            .iter()
            .map(move |place| body_from_world * place)
    }
}
