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
/// Deviation of the direction of a velocity, rad, and of how fast it turns, rad/s, when a body
/// begins to move; and how much the turning changes, rad/s per root of a second.
const DIRECTION_DEVIATION: f64 = 0.1;
const TURN_DEVIATION: f64 = 0.5;
const TURN_NOISE: f64 = 0.8;
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
    /// Rate at which its velocity turns, rad/s, counter-clockwise; zero at rest.
    pub turn_radps: f64,
    /// Half the diagonal of the box around all returns of its body, m.
    pub radius_m: f64,
}

impl Sighting {
    /// Its body moves.
    pub fn moves(&self) -> bool {
        self.velocity_body != Vector::zeros()
    }
}

/// How a body moves over ground: its velocity in the world frame, m/s, and the rate at which
/// that turns, rad/s.
#[derive(Debug, Clone, Copy)]
struct Motion {
    velocity_world: Vector,
    turn_radps: f64,
}

impl Motion {
    const REST: Self = Self {
        velocity_world: Vector::new(0.0, 0.0),
        turn_radps: 0.0,
    };
}

#[derive(Debug, Clone, Copy)]
struct Track {
    x: Kalman,
    y: Kalman,
    /// Direction of the velocity in the world frame, rad, without jumps, and its rate; once it
    /// moves.
    direction: Option<Kalman>,
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
            direction: None,
            middle: cluster.middle,
            begin: cluster.middle,
            radius_m: cluster.radius_m,
            seen: 1,
            still: 0,
            missed: 0,
            taken: true,
        }
    }

    /// Takes its cluster of this scan; how the body moves.
    fn take(&mut self, cluster: &Cluster) -> Motion {
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
            true => Motion {
                velocity_world: velocity,
                turn_radps: self.turn_radps(velocity),
            },
            false => {
                self.direction = None;
                Motion::REST
            }
        }
    }

    /// Takes the direction of this scan's velocity; the rate at which it turns, rad/s.
    fn turn_radps(&mut self, velocity: Vector) -> f64 {
        let now_rad = velocity.y.atan2(velocity.x);
        let direction = self.direction.get_or_insert_with(|| {
            Kalman::new((now_rad, DIRECTION_DEVIATION), (0.0, TURN_DEVIATION))
        });
        let change_rad = vehicle::wrap_rad(now_rad - direction.value());
        direction.measure(direction.value() + change_rad, DIRECTION_DEVIATION);
        direction.driver()
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
                turn_radps: 0.0,
                radius_m: 0.0,
            });
        }
        for track in &mut self.tracks {
            let noise = VELOCITY_NOISE * step_s.sqrt();
            track.x.predict(1.0, step_s, noise);
            track.y.predict(1.0, step_s, noise);
            if let Some(direction) = &mut track.direction {
                direction.predict(1.0, step_s, TURN_NOISE * step_s.sqrt());
            }
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
        let found: heapless::Vec<Option<Motion>, CLUSTERS_MAX> = found.collect();
        for (cluster, found) in clusters.iter().zip(found) {
            let motion = found.unwrap_or_else(|| self.follow(cluster));
            self.mark(cluster, &world_from_body, motion);
        }
        self.tracks.retain(|track| track.missed <= MISSED_MAX);
    }

    /// A cluster that is where a track was last is that track; after some scans
    /// of that it rests, even if it seemed to move before. Returns how it moves.
    fn find_resting(&mut self, cluster: &Cluster, still_m: f64) -> Option<Motion> {
        let is_there =
            |track: &&mut Track| !track.taken && (track.middle - cluster.middle).norm() < still_m;
        let track = self.tracks.iter_mut().find(is_there)?;
        if track.still + 1 < STILL_MIN {
            let still = track.still + 1;
            let motion = track.take(cluster);
            track.still = still;
            return Some(motion);
        }
        *track = Track {
            still: track.still,
            ..Track::new(cluster)
        };
        Some(Motion::REST)
    }

    /// Gives a cluster to its track, or begins one; how it moves.
    fn follow(&mut self, cluster: &Cluster) -> Motion {
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
            return Motion::REST;
        };
        track.take(cluster)
    }

    fn mark(&mut self, cluster: &Cluster, world_from_body: &Pose, motion: Motion) {
        let velocity_body = world_from_body.rotation.inverse() * motion.velocity_world;
        let count = self.sightings.len();
        for offset in 0..cluster.count {
            let sighting = &mut self.sightings[(cluster.first + offset) % count];
            (sighting.velocity_body, sighting.turn_radps) = (velocity_body, motion.turn_radps);
            sighting.radius_m = cluster.radius_m;
        }
    }
}

const _: () = assert!(CLUSTERS_MAX <= TRACKS_MAX, "every cluster can be followed");

#[cfg(test)]
mod tests;
