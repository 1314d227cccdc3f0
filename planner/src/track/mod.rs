//! What moves: the car's own state, and the bodies that the lidar sees.
//!
//! The returns of a scan are parted into clusters; a cluster is followed from
//! scan to scan by a Kalman filter of constant velocity in the world frame.

mod cluster;
mod ego;
mod kalman;

pub(crate) use ego::{EgoFilter, YAW_LAG_S};

use shm_config::message::{BEAMS_MAX, Observation};
use vehicle::{Point, Pose, Vector, pose};

use crate::beams::Beams;
use cluster::{CLUSTERS_MAX, Cluster, clusters};
use kalman::Kalman;

/// Most bodies followed at a time.
const TRACKS_MAX: usize = 64;
/// A cluster belongs to a track when it is nearer than this to where the track
/// should be, m: a car seen from another side moves its middle by half its length.
const GATE_M: f64 = 2.5;
/// How well the middle of a cluster is measured, m: its seen part changes.
const MIDDLE_DEVIATION_M: f64 = 0.4;
/// Change of velocity of traffic, m/s per root of a second.
const VELOCITY_NOISE: f64 = 2.0;
/// First guess of a velocity: none, but up to this, m/s.
const VELOCITY_DEVIATION: f64 = 5.0;
/// A track counts after it was seen this often, and is dropped after it was
/// not seen this often.
const SEEN_MIN: u32 = 4;
const MISSED_MAX: u32 = 5;
/// A slower track rests, m/s.
const RESTING_MPS: f64 = 1.5;
/// After so many scans at one place a body rests; a moving one that comes into
/// view may seem to stand for one or two.
const STILL_MIN: u32 = 3;
/// How far the middle of a resting body's box jumps from scan to scan, m.
const JITTER_M: f64 = 0.05;
/// A body has moved when the middle of its box has left the largest box it was
/// seen in by this, m. A standing car that is passed, or a row of cones that
/// comes into view, seems to move as well, but never that far.
const LEFT_M: f64 = 0.5;
/// A larger box, half its diagonal, m, holds more than one vehicle, and rests.
const VEHICLE_M: f64 = 3.6;

/// One lidar return with the velocity of its body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Where, in the body frame, m.
    pub point_body: Point,
    /// Velocity over ground, in the body frame's directions, m/s; zero at rest.
    pub velocity_body: Vector,
    /// Half the diagonal of the box around all returns of its body, m.
    pub radius_m: f64,
}

impl Sighting {
    /// Its body moves.
    pub fn moves(&self) -> bool {
        self.velocity_body != Vector::zeros()
    }
}

#[derive(Debug, Clone, Copy)]
struct Track {
    x: Kalman,
    y: Kalman,
    /// Where its middle was last.
    middle: Point,
    /// Where its middle was first, and the largest box it was seen in.
    begin: Point,
    radius_m: f64,
    seen: u32,
    /// For so many scans it has been where it was.
    still: u32,
    missed: u32,
    /// Already has its cluster of this scan.
    taken: bool,
}

impl Track {
    /// Of a cluster that is seen for the first time, or rests.
    fn new(cluster: &Cluster) -> Self {
        let begin = |at_m| Kalman::new((at_m, MIDDLE_DEVIATION_M), (0.0, VELOCITY_DEVIATION));
        Self {
            x: begin(cluster.middle.x),
            y: begin(cluster.middle.y),
            middle: cluster.middle,
            begin: cluster.middle,
            radius_m: cluster.radius_m,
            seen: 1,
            still: 0,
            missed: 0,
            taken: true,
        }
    }

    /// Takes its cluster of this scan; the velocity over ground, or zero at rest.
    fn take(&mut self, cluster: &Cluster) -> Vector {
        self.x.measure(cluster.middle.x, MIDDLE_DEVIATION_M);
        self.y.measure(cluster.middle.y, MIDDLE_DEVIATION_M);
        (self.taken, self.missed, self.still) = (true, 0, 0);
        self.middle = cluster.middle;
        self.seen += 1;
        self.radius_m = self.radius_m.max(cluster.radius_m);
        let velocity = Vector::new(self.x.driver(), self.y.driver());
        let went_m = (cluster.middle - self.begin).norm();
        let has_moved = went_m > self.radius_m + LEFT_M && self.radius_m <= VEHICLE_M;
        match has_moved && self.seen >= SEEN_MIN && velocity.norm() >= RESTING_MPS {
            true => velocity,
            false => Vector::zeros(),
        }
    }
}

/// Follows bodies from scan to scan. All memory is its own.
#[derive(Debug, Default)]
pub struct Tracker {
    beams: Beams,
    tracks: heapless::Vec<Track, TRACKS_MAX>,
    sightings: heapless::Vec<Sighting, BEAMS_MAX>,
}

impl Tracker {
    /// Nothing was seen yet.
    pub fn forget(&mut self) {
        self.tracks.clear();
    }

    /// All returns of the last scan.
    pub fn sightings(&self) -> &[Sighting] {
        &self.sightings
    }

    /// Takes a scan in, `step_s` after the last one.
    pub fn update(&mut self, observation: &Observation, step_s: f64) {
        let ego = &observation.ego;
        let world_from_body = pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
        self.beams.prepare(observation.fan());
        let mut returns_world = heapless::Vec::<(Point, f64), BEAMS_MAX>::new();
        self.sightings.clear();
        for point_body in self.beams.returns(observation) {
            // Both have room for every beam.
            let _ = returns_world.push((world_from_body * point_body, point_body.coords.norm()));
            let _ = self.sightings.push(Sighting {
                point_body,
                velocity_body: Vector::zeros(),
                radius_m: 0.0,
            });
        }
        for track in &mut self.tracks {
            let noise = VELOCITY_NOISE * step_s.sqrt();
            track.x.predict(1.0, step_s, noise);
            track.y.predict(1.0, step_s, noise);
            track.taken = false;
            track.missed += 1;
        }
        let clusters = clusters(&returns_world);
        // First the clusters that have not moved: otherwise neighbours in a row of cones
        // would exchange their tracks and seem to move.
        let still = RESTING_MPS * step_s + JITTER_M;
        let found = clusters
            .iter()
            .map(|cluster| self.find_resting(cluster, still));
        let found: heapless::Vec<Option<Vector>, CLUSTERS_MAX> = found.collect();
        for (cluster, found) in clusters.iter().zip(found) {
            let velocity_world = found.unwrap_or_else(|| self.follow(cluster));
            self.mark(cluster, &world_from_body, velocity_world);
        }
        self.tracks.retain(|track| track.missed <= MISSED_MAX);
    }

    /// A cluster that is where a track was last is that track; after some scans
    /// of that it rests, even if it seemed to move before. Returns its velocity.
    fn find_resting(&mut self, cluster: &Cluster, still_m: f64) -> Option<Vector> {
        let is_there =
            |track: &&mut Track| !track.taken && (track.middle - cluster.middle).norm() < still_m;
        let track = self.tracks.iter_mut().find(is_there)?;
        if track.still + 1 < STILL_MIN {
            let still = track.still + 1;
            let velocity = track.take(cluster);
            track.still = still;
            return Some(velocity);
        }
        *track = Track {
            still: track.still,
            ..Track::new(cluster)
        };
        Some(Vector::zeros())
    }

    /// Gives a cluster to its track, or begins one; the velocity over ground, or
    /// zero at rest.
    fn follow(&mut self, cluster: &Cluster) -> Vector {
        let away = |track: &Track| {
            (Point::new(track.x.value(), track.y.value()) - cluster.middle).norm_squared()
        };
        let nearest = self
            .tracks
            .iter_mut()
            .filter(|track| !track.taken && away(track) < GATE_M * GATE_M)
            .min_by(|a, b| away(a).total_cmp(&away(b)));
        let Some(track) = nearest else {
            // Without a free track it is not followed, and rests.
            let _ = self.tracks.push(Track::new(cluster));
            return Vector::zeros();
        };
        track.take(cluster)
    }

    fn mark(&mut self, cluster: &Cluster, world_from_body: &Pose, velocity_world: Vector) {
        let velocity_body = world_from_body.rotation.inverse() * velocity_world;
        let count = self.sightings.len();
        for offset in 0..cluster.count {
            let sighting = &mut self.sightings[(cluster.first + offset) % count];
            sighting.velocity_body = velocity_body;
            sighting.radius_m = cluster.radius_m;
        }
    }
}

const _: () = assert!(CLUSTERS_MAX <= TRACKS_MAX, "every cluster can be followed");

#[cfg(test)]
mod tests;
