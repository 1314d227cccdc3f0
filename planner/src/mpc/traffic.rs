//! What moves, and how it may go on.

use shm_config::config::Mpc as Config;
use shm_config::message::{BEAMS_MAX, PLANNED_MAX};
use vehicle::{Point, Vector, Vehicle, wrap_rad};

use crate::mpc::line::Line;
use tracker::Sighting;

/// Instants looked at: every second one of a profile.
const LOOKS: usize = PLANNED_MAX;
/// Longest horizon of a prediction, s.
const PREDICT_S: f64 = 4.0;
/// More ways in which bodies may go on than there are: two for each of the 64 of a scan.
const MOTIONS_MAX: usize = 256;
/// Longest turn that is predicted, rad.
const TURN_MAX_RAD: f64 = 1.6;
/// A body whose direction differs from the road's by this, rad, may turn into it, with this
/// radius, m: that of a roundabout's ring.
const JOIN_RAD: std::ops::Range<f64> = 0.35..2.4;
const JOIN_RADIUS_M: f64 = 11.0;
/// How far beside the car, m, a body behind it is in the car's own lane.
const OWN_LANE_M: f64 = 0.5;

/// A return of a moving body, and one way in which it may move.
pub(crate) struct Foe {
    point_body: Point,
    motion: usize,
    /// Whether it comes from behind, in another lane.
    pub(crate) is_behind: bool,
}

/// How a body may go on: its velocity now, and how far it has moved at each instant looked at.
struct Motion {
    velocity_body: Vector,
    by_m: [Vector; LOOKS],
}

/// All that moves around the car, each return with each way in which it may go on: as it
/// turns now, or into the road ahead; or straight on alone, if the driver is not wary.
#[derive(Default)]
pub(crate) struct Traffic {
    foes: heapless::Vec<Foe, { 2 * BEAMS_MAX }>,
    motions: heapless::Vec<Motion, MOTIONS_MAX>,
    step_s: f64,
    is_wary: bool,
}

impl std::fmt::Debug for Traffic {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "{} returns that move", self.foes.len())
    }
}

impl Traffic {
    /// Predicts the bodies of these sightings, at every second step.
    pub(crate) fn predict(
        &mut self,
        line: &Line,
        sightings: &[Sighting],
        (vehicle, config): (&Vehicle, &Config),
    ) {
        self.foes.clear();
        self.motions.clear();
        (self.step_s, self.is_wary) = (config.step_s, config.wary);
        let (mut velocity_body, mut ways) = (Vector::zeros(), 0..0);
        for sighting in sightings.iter().filter(|sighting| sighting.moves()) {
            let point_body = sighting.point_body;
            let is_behind =
                point_body.x < -vehicle.length_m / 2.0 && sighting.velocity_body.x > 0.0;
            let is_in_lane = point_body.y.abs() < vehicle.width_m / 2.0 + OWN_LANE_M;
            // A body that approaches from behind can see the car; a stop would block its path.
            if is_behind && (is_in_lane || !self.is_wary) {
                continue;
            }
            // The returns of a body follow each other, and have one velocity.
            if sighting.velocity_body != velocity_body {
                velocity_body = sighting.velocity_body;
                ways = self.suppose(line, sighting);
            }
            for motion in ways.clone() {
                // There are at most two ways for each beam, so there is room.
                let _ = self.foes.push(Foe {
                    point_body,
                    motion,
                    is_behind,
                });
            }
        }
    }

    /// The steps that are looked at.
    pub(crate) fn steps(&self) -> impl Iterator<Item = usize> {
        let steps = match self.foes.is_empty() {
            true => 0,
            false => ((PREDICT_S / self.step_s) as usize).min(2 * LOOKS),
        };
        (1..=steps).step_by(2)
    }

    /// All returns, each with each of its ways.
    pub(crate) fn foes(&self) -> &[Foe] {
        &self.foes
    }

    /// Where it is at an instant looked at, and its velocity now, m/s; both in the body frame
    /// of now.
    pub(crate) fn then(&self, foe: &Foe, look: usize) -> (Point, Vector) {
        let motion = &self.motions[foe.motion];
        (foe.point_body + motion.by_m[look], motion.velocity_body)
    }

    /// Adds the ways in which a body may go on; returns their indices.
    fn suppose(&mut self, line: &Line, sighting: &Sighting) -> std::ops::Range<usize> {
        let velocity_body = sighting.velocity_body;
        let first = self.motions.len();
        if !self.is_wary {
            self.turn(velocity_body, 0.0, 0.0);
            return first..self.motions.len();
        }
        self.turn(velocity_body, sighting.turn_radps, TURN_MAX_RAD);
        let along_m = line.place(sighting.point_body).along_m;
        let road_rad = line.body_from_road(along_m).rotation.angle();
        let off_rad = wrap_rad(road_rad - velocity_body.y.atan2(velocity_body.x));
        if JOIN_RAD.contains(&off_rad.abs()) {
            let turn_radps = velocity_body.norm() / JOIN_RADIUS_M * off_rad.signum();
            self.turn(velocity_body, turn_radps, off_rad.abs());
        }
        first..self.motions.len()
    }

    fn turn(&mut self, velocity_body: Vector, turn_radps: f64, most_rad: f64) {
        let by_m = |look: usize| {
            let then_s = (1 + 2 * look) as f64 * self.step_s;
            arc_m(velocity_body, turn_radps, most_rad, then_s)
        };
        let motion = Motion {
            velocity_body,
            by_m: std::array::from_fn(by_m),
        };
        // There is room for all.
        let _ = self.motions.push(motion);
    }
}

/// How far a body moves in a time, m, that turns at a rate up to an angle and then goes
/// straight on.
fn arc_m(velocity: Vector, turn_radps: f64, most_rad: f64, time_s: f64) -> Vector {
    let angle_rad = (turn_radps * time_s).clamp(-most_rad, most_rad);
    if angle_rad.abs() < 1e-3 {
        return velocity * time_s;
    }
    let arc_s = angle_rad / turn_radps;
    let left = Vector::new(-velocity.y, velocity.x);
    let (sin, cos) = angle_rad.sin_cos();
    let chord = (velocity * sin + left * (1.0 - cos)) * (arc_s / angle_rad);
    chord + (velocity * cos + left * sin) * (time_s - arc_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turn_follows_its_circle_and_then_its_tangent() {
        // 10 m/s on a radius of 10 m: a quarter of a circle takes pi/2 s.
        let quarter_s = std::f64::consts::FRAC_PI_2;
        let at = |time_s| arc_m(Vector::new(10.0, 0.0), 1.0, quarter_s, time_s);
        assert!((at(quarter_s) - Vector::new(10.0, 10.0)).norm() < 1e-9);
        assert!((at(quarter_s + 1.0) - Vector::new(10.0, 20.0)).norm() < 1e-9);
        let right = arc_m(Vector::new(10.0, 0.0), -1.0, quarter_s, quarter_s);
        assert!((right - Vector::new(10.0, -10.0)).norm() < 1e-9);
        assert_eq!(
            arc_m(Vector::new(3.0, 4.0), 0.0, 1.0, 2.0),
            Vector::new(6.0, 8.0)
        );
    }

    /// What is predicted of one body on a straight road, from its place and velocity.
    fn predicted(is_wary: bool, at: (f64, f64), velocity: (f64, f64)) -> Box<Traffic> {
        let mut observation = shm_config::message::Observation::default();
        (observation.road.left_m, observation.road.right_m) = (5.25, 5.25);
        observation.checkpoints[0].x_body_m = 60.0;
        observation.checkpoints[1].x_body_m = 60.0;
        let body = Sighting {
            beam: 0,
            point_body: Point::new(at.0, at.1),
            velocity_body: Vector::new(velocity.0, velocity.1),
            turn_radps: 0.5,
            radius_m: 2.0,
        };
        let config = Config {
            wary: is_wary,
            ..Config::default()
        };
        let mut traffic = Box::<Traffic>::default();
        let line = Line::new(&observation);
        traffic.predict(&line, &[body], (&Vehicle::default(), &config));
        traffic
    }

    #[test]
    fn what_comes_from_the_side_may_turn_into_the_road() {
        let traffic = predicted(true, (20.0, -10.0), (0.0, 8.0));
        let [turns, joins] = traffic.foes() else {
            panic!("{traffic:?}");
        };
        // After 2.1 s it has turned to the left by 1.05 rad, or into the road.
        let look = 10;
        let (turned, _) = traffic.then(turns, look);
        assert!(turned.x < 14.0, "{turned:?}");
        let (joined, _) = traffic.then(joins, look);
        assert!(joined.x > 27.0 && joined.y < 2.0, "{joined:?}");
        let traffic = predicted(false, (20.0, -10.0), (0.0, 8.0));
        let [straight_on] = traffic.foes() else {
            panic!("{traffic:?}");
        };
        let (then, _) = traffic.then(straight_on, look);
        assert!((then - Point::new(20.0, 6.8)).norm() < 1e-9, "{then:?}");
    }

    #[test]
    fn what_comes_from_behind_counts_in_another_lane_alone() {
        for (is_wary, left_m, count) in [(true, 0.5, 0), (true, 3.5, 1), (false, 3.5, 0)] {
            let traffic = predicted(is_wary, (-8.0, left_m), (9.0, 0.0));
            assert_eq!(traffic.foes().len(), count, "{is_wary} {left_m} m");
            assert!(traffic.foes().iter().all(|foe| foe.is_behind));
        }
    }
}
