//! A kinematic car in a ring-shaped corridor. Put your machine behind `obey` and `read`.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_6, TAU};
use std::process::ExitCode;

use robot::{Action, Bend, Bicycle, Checkpoint, Observation, Outcome, Point, Reading};
use robot::{Road, Robot, Status, scan, wrap_rad};

const RADIUS_M: f64 = 40.0;
const INNER_M: f64 = RADIUS_M - 5.0;
const OUTER_M: f64 = RADIUS_M + 5.0;

struct Car {
    bicycle: Bicycle,
    /// How far round the ring it has driven, rad.
    round_rad: f64,
}

impl Car {
    /// Its angle on the ring, rad, and its distance from the ring's centre, m.
    fn polar(&self) -> (f64, f64) {
        let place = self.bicycle.state.position;
        (place.y.atan2(place.x), place.coords.norm())
    }

    /// Distance from the scanner to the nearest wall in a direction from the heading, m.
    fn range_m(&self, scanner_body: Point, direction_rad: f64) -> f64 {
        let (sin, cos) = (self.bicycle.state.heading_rad + direction_rad).sin_cos();
        let place = (self.bicycle.state.pose() * scanner_body).coords;
        let along = place.x * cos + place.y * sin;
        // Where |place + t * direction| is a wall's radius.
        let root = |wall_m: f64| (along * along - place.norm_squared() + wall_m * wall_m).sqrt();
        match -along - root(INNER_M) {
            inner_m if inner_m > 0.0 => inner_m,
            _ => -along + root(OUTER_M),
        }
    }

    /// The middle of the ring at an angle, as the end of a bend of 30 degrees.
    fn checkpoint(&self, angle_rad: f64) -> Checkpoint {
        let place = Point::new(angle_rad.cos(), angle_rad.sin()) * RADIUS_M;
        let body = self.bicycle.state.pose().inverse_transform_point(&place);
        Checkpoint {
            x_body_m: body.x,
            y_body_m: body.y,
            bend_radius_m: INNER_M,
            bend_angle_rad: FRAC_PI_6,
            bend: Bend::Left.code(),
            reserved: 0,
        }
    }
}

impl Robot for Car {
    fn begin(&mut self, _seed: u64) -> Result<(), String> {
        self.bicycle.place(Point::new(RADIUS_M, 0.0), FRAC_PI_2);
        self.round_rad = 0.0;
        Ok(())
    }
    fn obey(&mut self, action: Action, step_s: f64) {
        let angle_rad = self.polar().0;
        self.bicycle.advance(action, step_s);
        self.round_rad += wrap_rad(self.polar().0 - angle_rad);
    }
    fn read(&mut self, observation: &mut Observation) -> Reading {
        let (angle_rad, radius_m) = self.polar();
        self.bicycle.fill(&mut observation.ego);
        observation.road = Road {
            left_m: radius_m - INNER_M,
            right_m: OUTER_M - radius_m,
            heading_rad: wrap_rad(self.bicycle.state.heading_rad - angle_rad - FRAC_PI_2),
            offset_m: RADIUS_M - radius_m,
            lane_width_m: 0.0,
        };
        let end_rad = ((angle_rad / FRAC_PI_6).floor() + 1.0) * FRAC_PI_6;
        observation.checkpoints = [end_rad, end_rad + FRAC_PI_6].map(|end| self.checkpoint(end));
        let scanner_body = observation.fan().mount_body;
        scan(observation, |rad| self.range_m(scanner_body, rad));
        Reading::Fresh
    }
    fn status(&self) -> Status {
        let side_m = (self.polar().1 - RADIUS_M).abs() + self.bicycle.vehicle.width_m / 2.0;
        let ended = (self.round_rad >= TAU)
            .then_some(Outcome::Arrived)
            .or((side_m > OUTER_M - RADIUS_M).then_some(Outcome::OutOfRoad));
        Status {
            ended,
            completion: (self.round_rad / TAU).clamp(0.0, 1.0),
            course_m: TAU * RADIUS_M,
            ..Status::default()
        }
    }
}

fn main() -> ExitCode {
    robot::drive(|config| {
        let (bicycle, round_rad) = (Bicycle::new(config.vehicle), 0.0);
        Ok(Car { bicycle, round_rad })
    })
}
