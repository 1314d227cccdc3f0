use vehicle::{Footprint, Vehicle, pose};

use crate::mpc::lattice::Path;
use crate::mpc::line::{Line, Place};
use crate::mpc::traffic::{Foe, Traffic};
use shm_config::config::Mpc as Config;
use shm_config::message::PLANNED_MAX;
use tracker::Sighting;

/// Instants of a profile: the steps, and as many after them.
const INSTANTS: usize = 2 * PLANNED_MAX;
/// Speed at the end of the known road, m/s: at it the car can drive, or brake for, any
/// bend of at least 10 m radius.
const UNKNOWN_MPS: f64 = 6.0;
/// Spacing along the path at which speed limits are computed, m.
const SPACING_M: f64 = 1.0;
const PLACES: usize = 64;
/// Gap kept to a moving body, m, and its growth with time, m/s: predictions become less
/// certain.
const GAP_M: f64 = 0.5;
const GAP_MPS: f64 = 0.15;
/// Gap kept to what comes from behind in another lane, m: it passes closely.
const GAP_BEHIND_M: f64 = 0.3;
/// Part of the gap ahead that grows with speed, s.
const HEADWAY_S: f64 = 0.4;
/// Acceleration that is planned with, m/s².
const ACCEL_MPS2: f64 = 2.0;

/// A body that shows at least this, half the diagonal of the box around its returns, m, may be
/// a car that pulls out. This and the next for a car as wide as the experiment's, m, and less
/// for a narrower one.
const CAR_M: f64 = 0.85;
const CAR_WIDTH_M: f64 = 1.852;
/// Nearer than this beside the path, m, it is passed slowly: at most so much faster than it
/// drives, m/s, so that there is time to stop when it pulls out.
const BESIDE_M: f64 = 1.9;
pub(crate) const PASS_MPS: f64 = 2.5;
/// Of a body that hardly moves, so much counts as along the road, m/s.
const ALONG_MPS: f64 = 1.0;

/// One way to drive along the path: a share of the wanted speed, and a share of
/// the planned deceleration to get down to it.
const WAYS: [(f64, f64); 9] = [
    (1.0, 1.0),
    (0.8, 1.0),
    (0.6, 1.0),
    (0.4, 1.0),
    (0.2, 1.0),
    (0.0, 1.0),
    (0.4, 2.0),
    (0.0, 2.0),
    (0.0, 3.0),
];

/// Where the car is to be along the path, step by step.
#[derive(Debug, Clone)]
pub(crate) struct Profile {
    /// Distance along the road, m, and speed, m/s, at each instant.
    at: heapless::Vec<(f64, f64), { INSTANTS + 1 }>,
    /// The car does not go beyond here, m along the road.
    pub(crate) stop_m: f64,
}

impl Profile {
    /// Distance along the road, m, and speed, m/s, after so many steps.
    pub(crate) fn at(&self, step: usize) -> (f64, f64) {
        self.at[step.min(self.at.len() - 1)]
    }
}

/// What a profile is chosen in.
pub(crate) struct Way<'a> {
    pub(crate) line: &'a Line,
    pub(crate) path: &'a Path,
    pub(crate) config: &'a Config,
    pub(crate) vehicle: &'a Vehicle,
    pub(crate) sightings: &'a [Sighting],
    /// Those of them that move.
    pub(crate) traffic: &'a Traffic,
}

impl Way<'_> {
    /// The fastest profile without a collision with a moving body; else the profile
    /// whose first collision is latest.
    pub(crate) fn choose(&self, speed_mps: f64) -> Profile {
        let stop_m = match self.path.is_blocked {
            true => (self.path.length_m() - self.config.standoff_m).max(0.0),
            false => f64::INFINITY,
        };
        let limits = self.limits_mps(stop_m);
        let mut best: Option<(f64, Profile)> = None;
        for (share, hardness) in WAYS {
            let profile = self.follow(&limits, speed_mps, share, hardness, stop_m);
            let met_s = self.meets_after_s(&profile);
            if met_s == f64::INFINITY {
                return profile;
            }
            // Of two that are as late, a wary driver takes the slower one: it may be later.
            let is_later = |(latest_s, _): &(f64, Profile)| {
                met_s > *latest_s || self.config.wary && met_s == *latest_s
            };
            if best.as_ref().is_none_or(is_later) {
                best = Some((met_s, profile));
            }
        }
        // There is at least one way, so there is a best one.
        best.map(|(_, profile)| profile)
            .unwrap_or_else(|| self.follow(&limits, speed_mps, 0.0, 1.0, stop_m))
    }

    /// Highest speed at each metre of the path: bends, and braking in time.
    fn limits_mps(&self, stop_m: f64) -> [f64; PLACES] {
        let Self {
            line, path, config, ..
        } = self;
        let mut limits = std::array::from_fn(|index| {
            let along_m = index as f64 * SPACING_M;
            let (left_m, _) = path.at(along_m);
            let road = line.curvature_per_m(along_m);
            let own = road / (1.0 - road * left_m).max(0.2) + path.bend_per_m(along_m);
            let bend_mps = (config.sideways_mps2 / own.abs().max(1e-6)).sqrt();
            let known_mps = match along_m < line.known_m() {
                true => f64::INFINITY,
                false => UNKNOWN_MPS,
            };
            config.speed_mps.min(bend_mps).min(known_mps)
        });
        if config.wary {
            self.slow_beside(&mut limits);
        }
        if stop_m.is_finite() {
            for (index, limit) in limits.iter_mut().enumerate() {
                if index as f64 * SPACING_M >= stop_m {
                    *limit = 0.0;
                }
            }
        }
        for index in (0..PLACES - 1).rev() {
            let next: f64 = limits[index + 1];
            let reachable = (next * next + 2.0 * config.brake_mps2 * SPACING_M).sqrt();
            limits[index] = limits[index].min(reachable);
        }
        limits
    }

    /// Lowers the limits beside bodies that may pull out.
    fn slow_beside(&self, limits: &mut [f64; PLACES]) {
        let half_length_m = self.vehicle.length_m / 2.0;
        let size = (self.vehicle.width_m / CAR_WIDTH_M).min(1.0);
        let near_m = self.vehicle.width_m / 2.0 + BESIDE_M * size;
        let may_be_car = |body: &&Sighting| body.radius_m > CAR_M * size;
        for sighting in self.sightings.iter().filter(may_be_car) {
            let Place { along_m, left_m } = self.line.place(sighting.point_body);
            let road = self.line.body_from_road(along_m).rotation;
            let velocity_road = road.inverse() * sighting.velocity_body;
            let is_along = velocity_road.x >= 0.0
                && 2.0 * velocity_road.y.abs() <= velocity_road.x.max(ALONG_MPS);
            let off_path_m = (left_m - self.path.at(along_m).0).abs();
            if !is_along || off_path_m > near_m {
                continue;
            }
            let place = |along_m: f64| (along_m / SPACING_M).max(0.0) as usize;
            let first = place(along_m - half_length_m);
            let end = place(along_m + half_length_m + SPACING_M);
            for limit in limits.iter_mut().take(end).skip(first) {
                *limit = limit.min(velocity_road.x + PASS_MPS);
            }
        }
    }

    /// Drives along the path within the limits.
    fn follow(
        &self,
        limits: &[f64; PLACES],
        speed_mps: f64,
        share: f64,
        hardness: f64,
        stop_m: f64,
    ) -> Profile {
        let step_s = self.config.step_s;
        let (mut along_m, mut speed_mps) = (0.0, speed_mps);
        let mut at = heapless::Vec::new();
        for _ in 0..=INSTANTS {
            // There is room for each.
            let _ = at.push((along_m, speed_mps));
            let place = (along_m / SPACING_M).min((PLACES - 2) as f64);
            let (index, part) = (place as usize, place.fract());
            let limit_mps = limits[index] * (1.0 - part) + limits[index + 1] * part;
            let wanted_mps = limit_mps.min(share * self.config.speed_mps);
            let least_mps = speed_mps - hardness * self.config.brake_mps2 * step_s;
            let most_mps = speed_mps + ACCEL_MPS2 * step_s;
            let next_mps = wanted_mps.clamp(least_mps.min(most_mps), most_mps).max(0.0);
            let (left_m, slope) = self.path.at(along_m);
            let bend = 1.0 - self.line.curvature_per_m(along_m) * left_m;
            let along_mps = (speed_mps + next_mps) / 2.0 / slope.hypot(1.0) / bend.max(0.2);
            along_m += along_mps * step_s;
            speed_mps = next_mps;
        }
        Profile { at, stop_m }
    }

    /// When the car would first come too near to a moving body, s.
    fn meets_after_s(&self, profile: &Profile) -> f64 {
        let Vehicle {
            length_m, width_m, ..
        } = *self.vehicle;
        let footprint = Footprint { length_m, width_m };
        for (look, step) in self.traffic.steps().enumerate() {
            let then_s = step as f64 * self.config.step_s;
            let (along_m, speed_mps) = profile.at(step);
            let (left_m, slope) = self.path.at(along_m);
            let road = self.line.body_from_road(along_m);
            let body_from_car = road * pose(0.0, left_m, slope.atan());
            let car_from_body = body_from_car.inverse();
            let meets = |foe: &Foe| {
                let (point_body, velocity_body) = self.traffic.then(foe, look);
                let mut point_car = car_from_body * point_body;
                let ahead_mps = (car_from_body.rotation * velocity_body).x;
                if point_car.x > 0.0 {
                    let ahead_m = HEADWAY_S * (speed_mps - ahead_mps.max(0.0)).max(0.0);
                    point_car.x = (point_car.x - ahead_m).max(0.0);
                }
                let gap_m = match foe.is_behind {
                    true => GAP_BEHIND_M,
                    false => GAP_M + GAP_MPS * then_s,
                };
                footprint.distance_m(point_car) < gap_m
            };
            if self.traffic.foes().iter().any(meets) {
                return then_s;
            }
        }
        f64::INFINITY
    }
}
