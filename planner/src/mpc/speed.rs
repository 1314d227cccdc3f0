use vehicle::{Footprint, Vehicle, pose};

use crate::mpc::lattice::Path;
use crate::mpc::line::Line;
use crate::track::Sighting;
use shm_config::config::Mpc as Config;
use shm_config::message::PLANNED_MAX;

/// Instants looked at: the steps, and as many after them.
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
/// Part of the gap ahead that grows with speed, s.
const HEADWAY_S: f64 = 0.4;
/// Longest horizon of a prediction, s.
const PREDICT_S: f64 = 4.0;
/// Acceleration that is planned with, m/s².
const ACCEL_MPS2: f64 = 2.0;

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
    /// Only those that move matter here.
    pub(crate) sightings: &'a [Sighting],
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
            if best.as_ref().is_none_or(|(latest_s, _)| met_s > *latest_s) {
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
        // A body that approaches from behind can see the car; a stop would block its
        // path.
        let follows = |sighting: &Sighting| {
            sighting.point_body.x < -length_m / 2.0 && sighting.velocity_body.x > 0.0
        };
        let moving = || {
            self.sightings
                .iter()
                .filter(|sighting| sighting.moves() && !follows(sighting))
        };
        if moving().next().is_none() {
            return f64::INFINITY;
        }
        let steps = (PREDICT_S / self.config.step_s) as usize;
        for step in (1..=steps.min(INSTANTS)).step_by(2) {
            let then_s = step as f64 * self.config.step_s;
            let (along_m, speed_mps) = profile.at(step);
            let (left_m, slope) = self.path.at(along_m);
            let road = self.line.body_from_road(along_m);
            let body_from_car = road * pose(0.0, left_m, slope.atan());
            let car_from_body = body_from_car.inverse();
            let gap_m = GAP_M + GAP_MPS * then_s;
            let meets = |sighting: &Sighting| {
                let point_body = sighting.point_body + sighting.velocity_body * then_s;
                let mut point_car = car_from_body * point_body;
                let velocity_car = car_from_body.rotation * sighting.velocity_body;
                if point_car.x > 0.0 {
                    let ahead_m = HEADWAY_S * (speed_mps - velocity_car.x.max(0.0)).max(0.0);
                    point_car.x = (point_car.x - ahead_m).max(0.0);
                }
                footprint.distance_m(point_car) < gap_m
            };
            if moving().any(meets) {
                return then_s;
            }
        }
        f64::INFINITY
    }
}
