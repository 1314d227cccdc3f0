use shm_config::message::Observation;
use vehicle::{Point, Pose, Vector};

use crate::centre_line::CentreLine;

/// Distance between two knots, m.
const SPACING_M: f64 = 1.0;
/// How many knots; with it the line is longer than any horizon.
const KNOTS: usize = 64;

/// A place along the road: `along_m` on its middle line from beside the car,
/// `left_m` to the left of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    pub(crate) along_m: f64,
    pub(crate) left_m: f64,
}

/// The middle line of the road as the frame that the car is controlled in.
#[derive(Debug)]
pub(crate) struct Line {
    knots: heapless::Vec<Knot, KNOTS>,
    first_m: f64,
    known_m: f64,
    half_width_m: f64,
    next_half_width_m: f64,
}

#[derive(Debug, Clone, Copy)]
struct Knot {
    body_from_road: Pose,
    curvature_per_m: f64,
}

/// Half the width of the next road is at most this many lanes, those of the experiment's
/// roads, which have three. A wider road of now (a ramp's extra lane) need not go on
/// beyond its end.
const NEXT_HALF_WIDTH_LANES: f64 = 1.5;

impl Line {
    /// The line of an observation; straight beyond its known part.
    pub(crate) fn new(observation: &Observation) -> Self {
        let centre = CentreLine::new(observation);
        let road = &observation.road;
        let half_width_m = ((road.left_m + road.right_m) / 2.0).max(0.0);
        Self {
            knots: (0..KNOTS)
                .map(|knot| {
                    let station = centre.at(knot as f64 * SPACING_M);
                    Knot {
                        body_from_road: station.body_from_road,
                        curvature_per_m: station.curvature_per_m,
                    }
                })
                .collect(),
            first_m: centre.first_length_m(),
            known_m: centre.length_m(),
            half_width_m,
            next_half_width_m: match road.lane_width_m > 0.0 {
                true => half_width_m.min(NEXT_HALF_WIDTH_LANES * road.lane_width_m),
                false => half_width_m,
            },
        }
    }

    /// Up to where the line is known, m.
    pub(crate) fn known_m(&self) -> f64 {
        self.known_m
    }

    /// Half the width of the road at a distance, m.
    pub(crate) fn half_width_m(&self, along_m: f64) -> f64 {
        match along_m <= self.first_m {
            true => self.half_width_m,
            false => self.next_half_width_m,
        }
    }

    /// Curvature at a distance, 1/m, counter-clockwise.
    pub(crate) fn curvature_per_m(&self, along_m: f64) -> f64 {
        self.knot(along_m).0.curvature_per_m
    }

    /// The frame of the road at a distance: x along it.
    pub(crate) fn body_from_road(&self, along_m: f64) -> Pose {
        let (knot, rest_m) = self.knot(along_m);
        let turn_rad = knot.curvature_per_m * rest_m;
        let half_rad = turn_rad / 2.0;
        // Within a knot's metre the chord of an arc is as long as the arc.
        let (sin, cos) = half_rad.sin_cos();
        knot.body_from_road * vehicle::pose(rest_m * cos, rest_m * sin, turn_rad)
    }

    /// A place as a point of the body frame, m.
    pub(crate) fn point_body(&self, place: Place) -> Point {
        self.body_from_road(place.along_m) * Point::new(0.0, place.left_m)
    }

    /// The place of a point: that of the nearest knot, carried on along its arc.
    pub(crate) fn place(&self, point_body: Point) -> Place {
        let away = |knot: &Knot| {
            let at: Vector = knot.body_from_road.translation.vector;
            (point_body.coords - at).norm_squared()
        };
        let mut nearest = (0, f64::INFINITY);
        for (index, knot) in self.knots.iter().enumerate() {
            let square = away(knot);
            if square < nearest.1 {
                nearest = (index, square);
            }
        }
        let knot = &self.knots[nearest.0];
        let at_road = knot.body_from_road.inverse_transform_point(&point_body);
        let curvature = knot.curvature_per_m;
        let begin_m = nearest.0 as f64 * SPACING_M;
        // Behind the car the road is taken as straight.
        if curvature.abs() < 1e-6 || (nearest.0 == 0 && at_road.x < 0.0) {
            return Place {
                along_m: begin_m + at_road.x,
                left_m: at_road.y,
            };
        }
        let (ahead, aside) = (curvature * at_road.x, 1.0 - curvature * at_road.y);
        Place {
            along_m: begin_m + ahead.atan2(aside) / curvature,
            left_m: (1.0 - ahead.hypot(aside)) / curvature,
        }
    }

    /// The knot at or before a distance, and the rest, m.
    fn knot(&self, along_m: f64) -> (&Knot, f64) {
        let index = ((along_m / SPACING_M).max(0.0) as usize).min(KNOTS - 1);
        (&self.knots[index], along_m - index as f64 * SPACING_M)
    }
}
