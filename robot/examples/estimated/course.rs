//! A loop of two straights and two bends between walls.

use std::f64::consts::PI;

use robot::route::{Route, Row};
use robot::{Contact, Outcome, Point, Status};
use vehicle::{Pose, Vehicle};

use crate::walls::{Wall, along};

const STRAIGHT_M: f64 = 50.0;
const RADIUS_M: f64 = 25.0;
const HALF_WIDTH_M: f64 = 4.5;
/// Distance between two rows of the route, m: a chord is 5 mm from its arc.
const ROW_M: f64 = 1.0;

/// The walls, and the middle line between them as a closed route.
pub struct Course {
    pub walls: Vec<Wall>,
    pub route: Route,
}

impl Course {
    /// # Errors
    /// None with the measures above.
    pub fn new() -> Result<Self, String> {
        let places = middle_line();
        let rows = places.iter().map(|(place, _)| Row {
            place: *place,
            left_m: HALF_WIDTH_M,
            right_m: HALF_WIDTH_M,
        });
        let route = Route::new(rows.collect(), true).map_err(|error| error.to_string())?;
        let mut walls = Vec::new();
        for side_m in [HALF_WIDTH_M, -HALF_WIDTH_M] {
            let beside = |(place, heading_rad): &(Point, f64)| {
                let (sin, cos) = heading_rad.sin_cos();
                Point::new(place.x - side_m * sin, place.y + side_m * cos)
            };
            let mut points: Vec<Point> = places.iter().map(beside).collect();
            points.extend(points.first().copied());
            walls.extend(along(&points));
        }
        Ok(Self { walls, route })
    }

    /// What the referee says of a car that has driven so far along the route.
    pub fn status(&self, world_from_body: &Pose, vehicle: &Vehicle, driven_m: f64) -> Status {
        let last_m = self
            .route
            .locate(world_from_body.translation.vector.into(), None);
        let near_m = Some(last_m.along_m);
        let off_m = |place: Point| self.route.locate(place, near_m).offset_m.abs();
        let corners = vehicle.footprint().corners(world_from_body);
        let touches = corners.iter().any(|corner| off_m(*corner) > HALF_WIDTH_M);
        let course_m = self.route.length_m();
        let ended = match (driven_m >= course_m, last_m.offset_m.abs() > HALF_WIDTH_M) {
            (_, true) => Some(Outcome::OutOfRoad),
            (true, false) => Some(Outcome::Arrived),
            (false, false) => None,
        };
        Status {
            ended,
            completion: (driven_m / course_m).clamp(0.0, 1.0),
            course_m,
            contact: match touches {
                true => Contact::Object,
                false => Contact::Free,
            },
        }
    }
}

/// Places of the middle line with its direction, rad.
fn middle_line() -> Vec<(Point, f64)> {
    let mut places = Vec::new();
    let bend_m = PI * RADIUS_M;
    for (begin, turned_rad) in [
        (Point::origin(), 0.0),
        (Point::new(STRAIGHT_M, 2.0 * RADIUS_M), PI),
    ] {
        let (sin, cos) = f64::sin_cos(turned_rad);
        let place =
            |x: f64, y: f64| begin + nalgebra::Vector2::new(cos * x - sin * y, sin * x + cos * y);
        let rows = (STRAIGHT_M / ROW_M).round();
        for row in 0..rows as usize {
            places.push((place(row as f64 * STRAIGHT_M / rows, 0.0), turned_rad));
        }
        let rows = (bend_m / ROW_M).round();
        for row in 0..rows as usize {
            let angle_rad = PI * row as f64 / rows;
            let (sin, cos) = angle_rad.sin_cos();
            let (x, y) = (STRAIGHT_M + RADIUS_M * sin, RADIUS_M * (1.0 - cos));
            places.push((place(x, y), turned_rad + angle_rad));
        }
    }
    places
}
