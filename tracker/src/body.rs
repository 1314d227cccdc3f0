use vehicle::{Point, Vector};

use crate::cluster::{Cluster, Returns};
use crate::kalman::Kalman;
use crate::kinematic::Kinematic;

/// How well a face of a body is measured, m, and the share of the beams' spacing there that
/// comes on top, along the body and across it.
const FACE_DEVIATION_M: f64 = 0.1;
const SPACING_SHARES: (f64, f64) = (0.15, 0.3);
/// Change of velocity of traffic, m/s per root of a second.
const VELOCITY_NOISE: f64 = 2.5;
/// First guess of a velocity: none, but up to this, m/s.
const VELOCITY_DEVIATION: f64 = 5.0;
/// Deviation of the direction of a velocity, rad, and of how fast it turns, rad/s, when a body
/// begins to move; and how much the turning changes, rad/s per root of a second.
const DIRECTION_DEVIATION: f64 = 0.1;
const TURN_DEVIATION: f64 = 0.5;
const TURN_NOISE: f64 = 0.8;
/// So many returns that show it say that a body moves; at most so many of one scan.
const CONFIRMED_AFTER: u32 = 3;
const EVIDENCE_MAX: u32 = 2;
/// Without any in more scans than this it rests after all.
const DOUBTED_AFTER: u32 = 8;
/// A body is at most so many times as long as it shows to be wide, and its outline is known
/// that well, m.
const LENGTH_SHARE: f64 = 3.0;
const BESIDE_M: f64 = 0.3;
/// A slower body rests, m/s, and one whose velocity is not known that well; faster than the
/// second, m/s, its velocity says where it looks.
const RESTING_MPS: f64 = 0.5;
const HEADED_MPS: f64 = 1.5;

/// How a body moves over ground: its velocity in the world frame, m/s, and the rate at which
/// that turns, rad/s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Motion {
    pub(crate) velocity_world: Vector,
    pub(crate) turn_radps: f64,
}

impl Motion {
    pub(crate) const REST: Self = Self {
        velocity_world: Vector::new(0.0, 0.0),
        turn_radps: 0.0,
    };
}

/// One of the faces across a body's direction, and one along it or the middle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Corner {
    is_front: bool,
    side: Side,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Right,
    Middle,
    Left,
}

/// The box around a cluster along a direction, from the scanner.
struct Outline {
    scanner: Point,
    forward: Vector,
    along_m: (f64, f64),
    left_m: (f64, f64),
}

impl Outline {
    fn new(cluster: &Cluster, returns: &Returns, scanner: Point, forward: Vector) -> Self {
        let left = Vector::new(-forward.y, forward.x);
        Self {
            scanner,
            forward,
            along_m: cluster.extent_m(returns, scanner, forward),
            left_m: cluster.extent_m(returns, scanner, left),
        }
    }

    /// The corner that is surely seen: of the faces that look to the scanner. Beside the
    /// scanner the face across stays the one it was.
    fn seen(&self, last: Corner) -> Corner {
        let is_front = match self.along_m {
            (low_m, _) if low_m > 0.0 => false,
            (_, high_m) if high_m < 0.0 => true,
            _ => last.is_front,
        };
        let side = match self.left_m {
            (low_m, _) if low_m > 0.0 => Side::Right,
            (_, high_m) if high_m < 0.0 => Side::Left,
            _ => Side::Middle,
        };
        Corner { is_front, side }
    }

    fn point(&self, corner: Corner) -> Point {
        let along_m = match corner.is_front {
            true => self.along_m.1,
            false => self.along_m.0,
        };
        let left_m = match corner.side {
            Side::Right => self.left_m.0,
            Side::Middle => (self.left_m.0 + self.left_m.1) / 2.0,
            Side::Left => self.left_m.1,
        };
        let left = Vector::new(-self.forward.y, self.forward.x);
        self.scanner + self.forward * along_m + left * left_m
    }
}

/// A body that is followed from scan to scan, by the corner that the scanner sees best.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Track {
    /// Its own number, from 1.
    pub(crate) id: u32,
    motion: Kinematic,
    corner: Corner,
    /// Where it looks, once that is known.
    forward: Option<Vector>,
    /// Direction of the velocity, rad, without jumps, and its rate; once it moves.
    direction: Option<Kalman>,
    /// So many returns showed that it moves, and since so many scans none.
    shown: u32,
    silent: u32,
    /// Since so many scans it is not seen.
    pub(crate) missed: u32,
}

/// What a scan tells of one body.
pub(crate) struct View<'a> {
    pub(crate) returns: &'a Returns,
    pub(crate) scanner: Point,
    /// Angle between two beams, rad.
    pub(crate) spacing_rad: f64,
}

impl Track {
    /// Of a cluster that is seen for the first time.
    pub(crate) fn new(id: u32, cluster: &Cluster, view: &View) -> Self {
        let corner = Corner {
            is_front: false,
            side: Side::Middle,
        };
        let forward = line_of_sight(cluster, view);
        let outline = Outline::new(cluster, view.returns, view.scanner, forward);
        let deviation = FACE_DEVIATION_M + spacing_m(cluster, view);
        Self {
            id,
            motion: Kinematic::new(outline.point(corner), deviation, VELOCITY_DEVIATION),
            corner,
            forward: None,
            direction: None,
            shown: 0,
            silent: 0,
            missed: 0,
        }
    }

    /// One step in time.
    pub(crate) fn predict(&mut self, step_s: f64) {
        self.motion.predict(step_s, VELOCITY_NOISE * step_s.sqrt());
        if let Some(direction) = &mut self.direction {
            direction.predict(1.0, step_s, TURN_NOISE * step_s.sqrt());
        }
        self.missed += 1;
    }

    /// How far a cluster is from where this body should be, m; infinite when that is surely
    /// farther than `most_m`.
    pub(crate) fn away_m(&self, cluster: &Cluster, view: &View, most_m: f64) -> f64 {
        // The corner is inside of the box, however that is turned.
        let reach_m = most_m + 2.0 * cluster.radius_m;
        if (cluster.middle - self.motion.at()).norm() > reach_m {
            return f64::INFINITY;
        }
        let outline = self.outline(cluster, view);
        (outline.point(self.corner) - self.motion.at()).norm()
    }

    fn outline(&self, cluster: &Cluster, view: &View) -> Outline {
        let forward = self.forward.unwrap_or_else(|| line_of_sight(cluster, view));
        Outline::new(cluster, view.returns, view.scanner, forward)
    }

    /// Whether a few returns beside its cluster belong to it as well. Beams that graze the side
    /// of a body hit it far apart, at places that stand still beside the scanner and not
    /// beside the body: alone they would seem to drive as fast as the own car.
    pub(crate) fn extends_to(&self, cluster: &Cluster, few: &Cluster, view: &View) -> bool {
        if self.forward.is_none() || self.shown < CONFIRMED_AFTER {
            return false;
        }
        let (own, other) = (self.outline(cluster, view), self.outline(few, view));
        let length_m = LENGTH_SHARE * (own.left_m.1 - own.left_m.0);
        let along_m = match self.corner.is_front {
            true => (own.along_m.1 - length_m, own.along_m.1),
            false => (own.along_m.0, own.along_m.0 + length_m),
        };
        let within = |(low_m, high_m): (f64, f64), (from_m, to_m): (f64, f64)| {
            from_m - BESIDE_M <= low_m && high_m <= to_m + BESIDE_M
        };
        within(other.along_m, along_m) && within(other.left_m, own.left_m)
    }

    /// Takes its cluster of this scan, with the number of returns that show that it moves;
    /// how the body moves.
    pub(crate) fn take(&mut self, cluster: &Cluster, view: &View, evidence: u32) -> Motion {
        let outline = self.outline(cluster, view);
        let corner = outline.seen(self.corner);
        if corner != self.corner {
            self.motion
                .shift(outline.point(corner) - outline.point(self.corner));
            self.corner = corner;
        }
        let spacing_m = spacing_m(cluster, view);
        let deviations = (
            FACE_DEVIATION_M + SPACING_SHARES.0 * spacing_m,
            FACE_DEVIATION_M + SPACING_SHARES.1 * spacing_m,
        );
        self.motion
            .measure(outline.point(corner), outline.forward, deviations);
        self.missed = 0;
        self.silent = match evidence {
            0 => self.silent.saturating_add(1),
            _ => 0,
        };
        self.shown = match self.silent > DOUBTED_AFTER {
            true => 0,
            false => self.shown.saturating_add(evidence.min(EVIDENCE_MAX)),
        };
        let velocity = self.motion.velocity();
        let speed_mps = velocity.norm();
        let least_mps = RESTING_MPS.max(self.motion.velocity_deviation());
        if self.shown < CONFIRMED_AFTER || speed_mps < least_mps {
            self.direction = None;
            return Motion::REST;
        }
        if speed_mps > HEADED_MPS {
            self.head(velocity / speed_mps, cluster, view);
        }
        Motion {
            velocity_world: velocity,
            turn_radps: self.turn_radps(velocity),
        }
    }

    /// It looks where it drives to.
    fn head(&mut self, forward: Vector, cluster: &Cluster, view: &View) {
        let before = self.outline(cluster, view).point(self.corner);
        self.forward = Some(forward);
        let outline = self.outline(cluster, view);
        self.corner = outline.seen(self.corner);
        self.motion.shift(outline.point(self.corner) - before);
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

/// The direction in which the scanner sees a cluster.
fn line_of_sight(cluster: &Cluster, view: &View) -> Vector {
    let away = cluster.middle - view.scanner;
    away.try_normalize(1e-6).unwrap_or_else(Vector::x)
}

/// How far apart the beams are where a cluster is, m.
fn spacing_m(cluster: &Cluster, view: &View) -> f64 {
    (cluster.middle - view.scanner).norm() * view.spacing_rad
}
