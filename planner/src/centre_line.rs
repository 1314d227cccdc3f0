use shm_config::message::Observation;
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Point, Pose, Vector, pose};

/// A checkpoint less than this ahead of the car, along the road, has been
/// passed, m. The world moves on to the next one up to 5 m late.
const PASSED_M: f64 = 1.0;

/// A goal lies at most this far after the last checkpoint, m: twice the 5 m around it
/// in which the car has arrived.
const BEYOND_M: f64 = 10.0;

/// One road of the route: an arc, or a straight line when the curvature is 0.
#[derive(Debug, Clone, Copy)]
struct Arc {
    /// Its beginning, x along the road.
    body_from_start: Pose,
    /// Counter-clockwise, 1/m.
    curvature_per_m: f64,
    length_m: f64,
}

/// A place on the middle line of the road ahead.
#[derive(Debug, Clone, Copy)]
pub struct Station {
    /// x along the road, y to its left.
    pub body_from_road: Pose,
    /// How far the road has turned since the car, rad, counter-clockwise.
    pub turn_rad: f64,
    /// Its curvature here, 1/m, counter-clockwise.
    pub curvature_per_m: f64,
}

/// The middle line of the road from beside the car to the second checkpoint.
///
/// The next checkpoint is the end of the car's road, at its middle. Together
/// with the direction of the road and the distances to its edges it fixes the
/// road's middle line, because a road of the map is one arc or one straight
/// line: it is the only arc that begins beside the car, along the road, and
/// ends in the checkpoint. The second checkpoint continues it in the same way.
#[derive(Debug)]
pub struct CentreLine {
    arcs: [Arc; 2],
    /// Whether its end is that of the route.
    is_last: bool,
}

impl CentreLine {
    /// From the edges, the heading and the checkpoints of an observation.
    /// Passed checkpoints are left out; with none left, the line is straight.
    pub fn new(observation: &Observation) -> Self {
        let road = &observation.road;
        let road_direction = pose(0.0, 0.0, -road.heading_rad);
        let beside = road_direction * Point::new(0.0, (road.left_m - road.right_m) / 2.0);
        let mut at = pose(beside.x, beside.y, -road.heading_rad);
        let mut arcs = [Arc::none(at); 2];
        for (arc, checkpoint) in arcs.iter_mut().zip(&observation.checkpoints) {
            let end_body = Point::new(checkpoint.x_body_m, checkpoint.y_body_m);
            *arc = Arc::to(at, end_body).unwrap_or(Arc::none(at));
            at = arc.at(arc.length_m).body_from_road;
        }
        let [first, second] = &observation.checkpoints;
        let is_last = (first.x_body_m, first.y_body_m) == (second.x_body_m, second.y_body_m);
        Self { arcs, is_last }
    }

    /// Length of the car's own road from beside the car on, m.
    #[cfg(feature = "std")]
    pub fn first_length_m(&self) -> f64 {
        self.arcs[0].length_m
    }

    /// Distance to its end along the line, m.
    pub fn length_m(&self) -> f64 {
        self.arcs.iter().map(|arc| arc.length_m).sum()
    }

    /// The farthest useful goal along it, m: its end; after the last checkpoint of the
    /// route, which an observation has twice, a little farther, so that the car can pass
    /// an obstacle on the goal line.
    pub fn known_m(&self) -> f64 {
        let beyond_m = if self.is_last { BEYOND_M } else { 0.0 };
        self.length_m() + beyond_m
    }

    /// How far along the line it goes straight on from a place on it, m; the
    /// place itself within a bend.
    pub fn straight_until(&self, distance_m: f64) -> f64 {
        let mut end_m = 0.0;
        for arc in &self.arcs {
            end_m += arc.length_m;
            if distance_m < end_m {
                // 10 km: 5 cm off the chord over the 60 m of the grid.
                return match arc.curvature_per_m.abs() < 1e-4 {
                    true => end_m,
                    false => distance_m,
                };
            }
        }
        f64::INFINITY
    }

    /// The place so far along the line, m; beyond its end, straight on.
    pub fn at(&self, distance_m: f64) -> Station {
        let [first, second] = &self.arcs;
        if distance_m <= first.length_m {
            return first.at(distance_m);
        }
        let beyond_m = distance_m - first.length_m;
        let mut station = second.at(beyond_m.min(second.length_m));
        let straight_m = (beyond_m - second.length_m).max(0.0);
        if straight_m > 0.0 {
            station.body_from_road *= pose(straight_m, 0.0, 0.0);
            station.curvature_per_m = 0.0;
        }
        station.turn_rad += first.curvature_per_m * first.length_m;
        station
    }
}

impl Arc {
    /// No road at all: where it begins, it ends.
    fn none(body_from_start: Pose) -> Self {
        Self {
            body_from_start,
            curvature_per_m: 0.0,
            length_m: 0.0,
        }
    }

    /// The arc that begins along x of `body_from_start` and ends in a point;
    /// `None` when the point is not ahead of it.
    ///
    /// An arc of less than half a turn has its end ahead; the map has none of more.
    fn to(body_from_start: Pose, end_body: Point) -> Option<Self> {
        let Vector { data, .. } = body_from_start.inverse_transform_point(&end_body).coords;
        let [[ahead_m, left_m]] = data.0;
        if ahead_m.is_nan() || left_m.is_nan() || ahead_m < PASSED_M {
            return None;
        }
        let chord_m = ahead_m.hypot(left_m);
        let curvature_per_m = 2.0 * left_m / (chord_m * chord_m);
        // Half the turn is the angle between the chord and the tangent.
        let turn_rad = 2.0 * left_m.atan2(ahead_m);
        // Below a microradian chord and arc are the same number.
        let length_m = if turn_rad.abs() < 1e-6 {
            chord_m
        } else {
            turn_rad / curvature_per_m
        };
        Some(Self {
            body_from_start,
            curvature_per_m,
            length_m,
        })
    }

    /// The place so far along the arc, m.
    fn at(&self, distance_m: f64) -> Station {
        let turn_rad = self.curvature_per_m * distance_m;
        let half_rad = turn_rad / 2.0;
        // Chord of the arc; sin(a)/a is 1 to the last bit below 1e-8.
        let chord_m = if half_rad.abs() < 1e-8 {
            distance_m
        } else {
            distance_m * half_rad.sin() / half_rad
        };
        let (sin, cos) = half_rad.sin_cos();
        Station {
            body_from_road: self.body_from_start * pose(chord_m * cos, chord_m * sin, turn_rad),
            turn_rad,
            curvature_per_m: self.curvature_per_m,
        }
    }
}
