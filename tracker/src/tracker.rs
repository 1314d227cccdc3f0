use shm_config::message::{
    BEAMS_MAX, MOTION_AT_REST, MOTION_FEATURES, Observation, motion_feature, motion_sector,
};
use vehicle::{Point, Pose, Vector, pose};

use crate::beams::Beams;
use crate::body::{Motion, Track, View};
use crate::cluster::{CLUSTERS_MAX, Cluster, Return, Returns, clusters};
use crate::past::Past;

/// Most bodies followed at a time.
const TRACKS_MAX: usize = 64;
/// A cluster belongs to a track when it is nearer than this to where the track
/// should be, m.
const GATE_M: f64 = 1.8;
/// Most pairs of a cluster and a track that near.
const PAIRS_MAX: usize = 512;
/// Fewer returns than this, or as many, may be a part of the body beside them.
const PART_MAX: usize = 2;
/// A track is dropped after it was not seen this often.
const MISSED_MAX: u32 = 5;
/// A pause between two scans after which bodies are followed anew, s: by then a car at
/// 15 m/s has left the gate of its track.
const PAUSE_S: f64 = 1.0;
/// A return that is nearer than this to one of a moving body belongs to that body, m.
const SAME_BODY_M: f64 = 0.5;

/// One lidar return with the velocity of its body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sighting {
    /// Number of its beam.
    pub beam: usize,
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

/// A return of a body that moves, over ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moving {
    point_world: Point,
    motion: Motion,
}

/// Follows bodies from scan to scan. All memory is its own.
///
/// The returns of a scan are parted into clusters, and a cluster is followed from scan to
/// scan. It moves when it is where earlier scans saw through, or when this one sees through
/// where it was: what comes into view behind another body does neither.
#[derive(Debug, Default)]
pub struct Tracker {
    beams: Beams,
    tracks: heapless::Vec<Track, TRACKS_MAX>,
    /// Number of the last track that was begun.
    last_id: u32,
    past: Past,
    sightings: heapless::Vec<Sighting, BEAMS_MAX>,
    /// Episode and instant of the last scan, ns, of [`Tracker::follow`].
    last: Option<(u32, u64)>,
}

impl Tracker {
    /// Nothing was seen yet.
    pub fn forget(&mut self) {
        self.tracks.clear();
        self.past.forget();
        self.last = None;
    }

    /// Takes the scan of an observation in, by the time that has passed since the last one;
    /// that of another episode, or after a pause, as the first. The last one again changes
    /// nothing.
    pub fn follow(&mut self, observation: &Observation) {
        let now = (observation.header.episode, observation.header.taken_ns);
        if self.last == Some(now) {
            return;
        }
        let since_s = self.last.and_then(|(episode, taken_ns)| {
            let passed_s = now.1.checked_sub(taken_ns)? as f64 * 1e-9;
            (episode == now.0 && passed_s <= PAUSE_S).then_some(passed_s)
        });
        if since_s.is_none() {
            self.forget();
        }
        self.last = Some(now);
        self.update(observation, since_s.unwrap_or(0.0));
    }

    /// Takes a single scan in, in which the returns of these bodies move and all others rest.
    pub fn suppose(&mut self, observation: &Observation, moving: &[Moving]) {
        self.forget();
        let world_from_body = world_from_body(observation);
        self.sight(observation, &world_from_body);
        for sighting in &mut self.sightings {
            let point_world = world_from_body * sighting.point_body;
            let away = |moving: &&Moving| (moving.point_world - point_world).norm_squared();
            let nearest = moving.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
            if let Some(body) = nearest.filter(|body| away(body) < SAME_BODY_M * SAME_BODY_M) {
                let velocity_world = body.motion.velocity_world;
                sighting.velocity_body = world_from_body.rotation.inverse() * velocity_world;
                sighting.turn_radps = body.motion.turn_radps;
            }
        }
    }

    /// The returns of the last scan, which is that of this observation, whose bodies move.
    pub fn moving(&self, observation: &Observation) -> impl Iterator<Item = Moving> {
        let world_from_body = world_from_body(observation);
        let moving = self.sightings.iter().filter(|sighting| sighting.moves());
        moving.map(move |sighting| Moving {
            point_world: world_from_body * sighting.point_body,
            motion: Motion {
                velocity_world: world_from_body.rotation * sighting.velocity_body,
                turn_radps: sighting.turn_radps,
            },
        })
    }

    /// How what the last scan shows moves, as a policy takes it: for each sector of the circle
    /// the velocity of the nearest return.
    pub fn motion(&self) -> [f32; MOTION_FEATURES] {
        let mut out = [MOTION_AT_REST; MOTION_FEATURES];
        let mut nearest_m = [f64::INFINITY; MOTION_FEATURES / 2];
        for sighting in &self.sightings {
            let away_m = sighting.point_body.coords.norm();
            let sector = motion_sector(sighting.beam);
            let Some(nearest_m) = nearest_m
                .get_mut(sector)
                .filter(|nearest| away_m < **nearest)
            else {
                continue;
            };
            *nearest_m = away_m;
            out[2 * sector] = motion_feature(sighting.velocity_body.x);
            out[2 * sector + 1] = motion_feature(sighting.velocity_body.y);
        }
        out
    }

    /// All returns of the last scan.
    pub fn sightings(&self) -> &[Sighting] {
        &self.sightings
    }

    /// Takes a scan in, `step_s` after the last one.
    pub fn update(&mut self, observation: &Observation, step_s: f64) {
        let world_from_body = world_from_body(observation);
        let returns = self.sight(observation, &world_from_body);
        for track in &mut self.tracks {
            track.predict(step_s);
        }
        self.past.begin(observation);
        let fan = observation.fan();
        let view = View {
            returns: &returns,
            scanner: world_from_body * fan.mount_body,
            spacing_rad: fan.spacing_rad(),
        };
        let clusters = clusters(&returns, fan.beams);
        let gone = self.gone();
        let found = self.associate(&clusters, &view);
        let parts = self.parts(&clusters, &found, &view);
        let mut motions: heapless::Vec<Motion, CLUSTERS_MAX> =
            clusters.iter().map(|_| Motion::REST).collect();
        for (number, cluster) in clusters.iter().enumerate() {
            if parts[number].is_some() {
                continue;
            }
            let Some(index) = found[number].or_else(|| self.begin(cluster, &view)) else {
                // Without a free track it is not followed, and rests.
                continue;
            };
            let is_new = |index: &usize| self.past.is_new(returns[*index].point_world);
            let arrived = cluster.indices(returns.len()).filter(is_new).count();
            let left = gone.get(index).copied().unwrap_or(0);
            let track = &mut self.tracks[index];
            motions[number] = track.take(cluster, &view, arrived as u32 + left);
            for index in cluster.indices(returns.len()) {
                self.past.own(returns[index].beam, track.id);
            }
        }
        for (number, cluster) in clusters.iter().enumerate() {
            let motion = motions[parts[number].unwrap_or(number)];
            self.mark(cluster, &world_from_body, motion);
        }
        self.tracks.retain(|track| track.missed <= MISSED_MAX);
        self.past.end();
    }

    /// Notes what the beams hit, at rest for now.
    fn sight(&mut self, observation: &Observation, world_from_body: &Pose) -> Returns {
        self.beams.prepare(observation.fan());
        let mut returns = Returns::new();
        self.sightings.clear();
        for (beam, point_body) in self.beams.returns(observation) {
            // Both have room for every beam.
            let _ = returns.push(Return {
                beam,
                point_world: world_from_body * point_body,
                range_m: point_body.coords.norm(),
            });
            let _ = self.sightings.push(Sighting {
                beam,
                point_body,
                velocity_body: Vector::zeros(),
                turn_radps: 0.0,
                radius_m: 0.0,
            });
        }
        returns
    }

    /// The track of each cluster, nearest pairs first.
    fn associate(
        &self,
        clusters: &[Cluster],
        view: &View,
    ) -> heapless::Vec<Option<usize>, CLUSTERS_MAX> {
        let mut pairs = heapless::Vec::<(f64, usize, usize), PAIRS_MAX>::new();
        for (cluster_index, cluster) in clusters.iter().enumerate() {
            for (track_index, track) in self.tracks.iter().enumerate() {
                let away_m = track.away_m(cluster, view, GATE_M);
                // A pair over the capacity is left out: its cluster begins a track.
                let _ = match away_m < GATE_M {
                    true => pairs.push((away_m, cluster_index, track_index)),
                    false => Ok(()),
                };
            }
        }
        pairs.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let mut found: heapless::Vec<Option<usize>, CLUSTERS_MAX> =
            clusters.iter().map(|_| None).collect();
        for (_, cluster, track) in pairs {
            if found[cluster].is_none() && !found.contains(&Some(track)) {
                found[cluster] = Some(track);
            }
        }
        found
    }

    /// The neighbour that a cluster of a few returns is a part of, for each cluster.
    fn parts(
        &self,
        clusters: &[Cluster],
        found: &[Option<usize>],
        view: &View,
    ) -> heapless::Vec<Option<usize>, CLUSTERS_MAX> {
        let is_part = |number: usize, whole: usize| {
            let (few, cluster) = (&clusters[number], &clusters[whole]);
            let track = found[whole].map(|index| &self.tracks[index]);
            few.count <= PART_MAX
                && cluster.count > PART_MAX
                && track.is_some_and(|track| track.extends_to(cluster, few, view))
        };
        let count = clusters.len();
        let numbers = 0..count;
        numbers
            .map(|number| {
                let neighbours = [(number + count - 1) % count, (number + 1) % count];
                neighbours.into_iter().find(|&whole| is_part(number, whole))
            })
            .collect()
    }

    /// How many returns of each track's earliest remembered scan are gone.
    fn gone(&self) -> heapless::Vec<u32, TRACKS_MAX> {
        let mut gone: heapless::Vec<u32, TRACKS_MAX> = self.tracks.iter().map(|_| 0).collect();
        for id in self.past.left() {
            let index = self.tracks.iter().position(|track| track.id == id);
            if let Some(gone) = index.and_then(|index| gone.get_mut(index)) {
                *gone += 1;
            }
        }
        gone
    }

    /// Begins a track; its index.
    fn begin(&mut self, cluster: &Cluster, view: &View) -> Option<usize> {
        // 0 is no track's.
        self.last_id = self.last_id.checked_add(1).unwrap_or(1);
        let track = Track::new(self.last_id, cluster, view);
        self.tracks.push(track).ok()?;
        Some(self.tracks.len() - 1)
    }

    fn mark(&mut self, cluster: &Cluster, world_from_body: &Pose, motion: Motion) {
        let velocity_body = world_from_body.rotation.inverse() * motion.velocity_world;
        let count = self.sightings.len();
        for index in cluster.indices(count) {
            let sighting = &mut self.sightings[index];
            (sighting.velocity_body, sighting.turn_radps) = (velocity_body, motion.turn_radps);
            sighting.radius_m = cluster.radius_m;
        }
    }
}

/// The car's pose in the world.
fn world_from_body(observation: &Observation) -> Pose {
    let ego = &observation.ego;
    pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad)
}

const _: () = assert!(CLUSTERS_MAX <= TRACKS_MAX, "every cluster can be followed");

#[cfg(test)]
mod tests;
