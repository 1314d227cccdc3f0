use core::f64::consts::{PI, TAU};

#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Pose, pose, rem_euclid};

/// An arc within this of a full turn counts as no arc, rad: rounding turns 0 into
/// -1e-16, which would become a full turn.
const SAME_RAD: f64 = 1e-9;

/// Which way a piece of a curve turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Turn {
    /// Counter-clockwise.
    Left,
    /// Not at all.
    Straight,
    /// Clockwise.
    Right,
}

/// A piece of a curve: an arc of the least radius, or a straight line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Which way.
    pub turn: Turn,
    /// How far, m.
    pub length_m: f64,
}

/// The shortest curve of a car with a least turning radius that only drives forwards:
/// at most three pieces (Dubins 1957).
///
/// The six words are those of Shkel & Lumelsky, *Classification of the Dubins
/// set*, 2001, Eq. 11 to 16; the three that begin to the left are computed as
/// the mirror image of the three that begin to the right, so that left and
/// right are treated alike, to the last bit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dubins {
    /// Radius of its arcs, m.
    pub radius_m: f64,
    /// Its pieces, one after the other; any of them may have no length.
    pub pieces: [Piece; 3],
}

/// The problem in units of the radius, rotated so that the end lies on x; `mirrored`
/// flips left and right.
#[derive(Clone, Copy)]
struct Question {
    distance: f64,
    /// Heading at the start and at the end, rad, with sine and cosine.
    start_rad: f64,
    end_rad: f64,
    start_sin: f64,
    start_cos: f64,
    end_sin: f64,
    end_cos: f64,
    /// Cosine of the angle between both headings.
    between_cos: f64,
}

impl Turn {
    /// 1 to the left, -1 to the right, 0 straight on.
    pub fn sign(self) -> f64 {
        match self {
            Turn::Left => 1.0,
            Turn::Straight => 0.0,
            Turn::Right => -1.0,
        }
    }

    fn mirrored(self) -> Self {
        match self {
            Turn::Left => Turn::Right,
            Turn::Straight => Turn::Straight,
            Turn::Right => Turn::Left,
        }
    }
}

impl Dubins {
    /// The shortest curve between two poses of one frame, metres; the radius is
    /// positive. Its end misses `to` by less than a billionth of the way.
    pub fn shortest(from: &Pose, to: &Pose, radius_m: f64) -> Self {
        let question = Question::new(from, to, radius_m);
        let mirror = question.mirrored();
        let mut best = (f64::INFINITY, [Turn::Straight; 3], [0.0; 3]);
        for (question, is_mirror) in [(question, false), (mirror, true)] {
            let words = [
                (
                    [Turn::Right, Turn::Straight, Turn::Right],
                    question.rsr(best.0),
                ),
                (
                    [Turn::Left, Turn::Straight, Turn::Right],
                    question.lsr(best.0),
                ),
                ([Turn::Right, Turn::Left, Turn::Right], question.rlr()),
            ];
            for (turns, lengths) in words {
                let Some(lengths) = lengths else { continue };
                let length = lengths[0] + lengths[1] + lengths[2];
                if length < best.0 {
                    best = match is_mirror {
                        false => (length, turns, lengths),
                        true => (length, turns.map(Turn::mirrored), lengths),
                    };
                }
            }
        }
        let (_, turns, lengths) = best;
        let piece = |which: usize| Piece {
            turn: turns[which],
            length_m: lengths[which] * radius_m,
        };
        Self {
            radius_m,
            pieces: [piece(0), piece(1), piece(2)],
        }
    }

    /// Length of the whole curve, m.
    pub fn length_m(&self) -> f64 {
        self.pieces.iter().map(|piece| piece.length_m).sum()
    }

    /// The pose so far along the curve, m; beyond its end, the end.
    pub fn at(&self, from: &Pose, distance_m: f64) -> Pose {
        let (mut at, mut left_m) = (*from, distance_m.max(0.0));
        for piece in &self.pieces {
            at *= self.moved(piece.turn, piece.length_m.min(left_m));
            left_m -= piece.length_m;
            if left_m <= 0.0 {
                break;
            }
        }
        at
    }

    /// Curvature so far along the curve, 1/m, counter-clockwise; where two
    /// pieces meet, that of the one behind.
    pub fn curvature_per_m(&self, distance_m: f64) -> f64 {
        let mut end_m = 0.0;
        for piece in &self.pieces {
            end_m += piece.length_m;
            if distance_m < end_m {
                return piece.turn.sign() / self.radius_m;
            }
        }
        self.pieces[2].turn.sign() / self.radius_m
    }

    /// The pieces with the pose where each begins.
    pub(crate) fn walk(&self, from: &Pose) -> impl Iterator<Item = (Pose, Piece)> {
        let mut at = *from;
        self.pieces.into_iter().map(move |piece| {
            let begin = at;
            at *= self.moved(piece.turn, piece.length_m);
            (begin, piece)
        })
    }

    /// The motion along a part of an arc or a straight line.
    pub(crate) fn moved(&self, turn: Turn, length_m: f64) -> Pose {
        let turn_rad = turn.sign() * length_m / self.radius_m;
        match turn {
            Turn::Straight => pose(length_m, 0.0, 0.0),
            Turn::Left | Turn::Right => {
                let (sin, cos) = turn_rad.sin_cos();
                let radius_m = turn.sign() * self.radius_m;
                pose(radius_m * sin, radius_m * (1.0 - cos), turn_rad)
            }
        }
    }
}

impl Question {
    fn new(from: &Pose, to: &Pose, radius_m: f64) -> Self {
        let end = from.inv_mul(to);
        let way = end.translation.vector;
        let distance_m = way.norm();
        // At no distance every direction is the one to the end.
        let (cos, sin) = match distance_m > 1e-12 * radius_m {
            true => (way.x / distance_m, way.y / distance_m),
            false => (1.0, 0.0),
        };
        let (turn_cos, turn_sin) = (end.rotation.re, end.rotation.im);
        let (end_cos, end_sin) = (
            turn_cos * cos + turn_sin * sin,
            turn_sin * cos - turn_cos * sin,
        );
        Self {
            distance: distance_m / radius_m,
            start_rad: (-sin).atan2(cos),
            end_rad: end_sin.atan2(end_cos),
            start_sin: -sin,
            start_cos: cos,
            end_sin,
            end_cos,
            between_cos: turn_cos,
        }
    }

    fn mirrored(&self) -> Self {
        Self {
            start_rad: -self.start_rad,
            end_rad: -self.end_rad,
            start_sin: -self.start_sin,
            end_sin: -self.end_sin,
            ..*self
        }
    }

    /// `None` also when it cannot be shorter than the limit, because its angles are
    /// expensive.
    fn rsr(&self, most: f64) -> Option<[f64; 3]> {
        let across = self.distance - self.start_sin + self.end_sin;
        let along = self.start_cos - self.end_cos;
        let straight = (across * across + along * along).sqrt();
        if straight >= most {
            return None;
        }
        // Both circles in one: the straight line has no direction.
        let line_rad = match straight > SAME_RAD {
            true => along.atan2(across),
            false => self.start_rad,
        };
        let first = turn(self.start_rad - line_rad);
        Some([first, straight, turn(line_rad - self.end_rad)])
    }

    /// `None` also when it cannot be shorter than the limit.
    fn lsr(&self, most: f64) -> Option<[f64; 3]> {
        let across = self.distance + self.start_sin + self.end_sin;
        let along = -self.start_cos - self.end_cos;
        let square = across * across + along * along - 4.0;
        if square < 0.0 {
            return None;
        }
        let straight = square.sqrt();
        if straight >= most {
            return None;
        }
        let line_rad = along.atan2(across) - (-2.0f64).atan2(straight);
        Some([
            turn(line_rad - self.start_rad),
            straight,
            turn(line_rad - self.end_rad),
        ])
    }

    fn rlr(&self) -> Option<[f64; 3]> {
        let Self { distance, .. } = *self;
        let sines = self.start_sin - self.end_sin;
        let cos =
            (6.0 - distance * distance + 2.0 * self.between_cos + 2.0 * distance * sines) / 8.0;
        if cos.is_nan() || cos.abs() > 1.0 {
            return None;
        }
        // The middle arc of a shortest curve is more than half a turn.
        let middle = TAU - cos.acos();
        debug_assert!(middle >= PI);
        let line_rad =
            (self.start_cos - self.end_cos).atan2(distance - self.start_sin + self.end_sin);
        let first = turn(self.start_rad - line_rad + middle / 2.0);
        let last = turn(self.start_rad - self.end_rad - first + middle);
        Some([first, middle, last])
    }
}

/// The angle within a full turn, rad, from 0 on.
fn turn(angle_rad: f64) -> f64 {
    // The same to the last bit as the remainder, which is slower, and rarely needed.
    let within_rad = match angle_rad {
        angle_rad if (0.0..TAU).contains(&angle_rad) => angle_rad,
        angle_rad if (-TAU..0.0).contains(&angle_rad) => angle_rad + TAU,
        angle_rad => rem_euclid(angle_rad, TAU),
    };
    match within_rad < TAU - SAME_RAD {
        true => within_rad,
        false => 0.0,
    }
}
