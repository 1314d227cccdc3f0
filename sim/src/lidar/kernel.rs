//! Distances from many beams to one shape, several beams at a time.
//!
//! Each lane does what the plain formula does, operation by operation and without
//! fusing a product and a sum, so the width of the vectors changes no bit. The tests hold
//! the formula and compare.

use pulp::Simd;
use vehicle::{Footprint, Vector};

use crate::contact::Shape;

/// Beams that are tested together: a multiple of every vector's width.
pub(super) const CHUNK: usize = 8;

/// The directions of some beams, as unit vectors in the frame of the lidar.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Beams {
    pub x: [f64; CHUNK],
    pub y: [f64; CHUNK],
}

/// What beams are tested against, in the frame of the shape.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    /// The shape.
    pub shape: Shape,
    /// Where the beams begin.
    pub from: Vector,
    /// The lidar's x axis.
    pub turn: Vector,
}

/// Lowers each range to the distance at which its beam meets the target.
#[inline(always)]
pub(super) fn shoot<S: Simd>(
    simd: S,
    target: &Target,
    beams: &[Beams],
    ranges_m: &mut [[f64; CHUNK]],
) {
    match target.shape {
        Shape::Box(footprint) => each(
            simd,
            target.turn,
            BoxSides::new(simd, target.from, footprint),
            (beams, ranges_m),
        ),
        Shape::Disc { radius_m } => each(
            simd,
            target.turn,
            Circle::new(simd, target.from, radius_m),
            (beams, ranges_m),
        ),
    }
}

/// The distance of a line's vector to a shape; infinite where it misses.
trait Outline<S: Simd>: Copy {
    fn distance_m(&self, simd: S, along: [S::f64s; 2]) -> S::f64s;
}

#[inline(always)]
fn each<S: Simd>(
    simd: S,
    turn: Vector,
    outline: impl Outline<S>,
    (beams, ranges_m): (&[Beams], &mut [[f64; CHUNK]]),
) {
    let (turn_x, turn_y) = (simd.splat_f64s(turn.x), simd.splat_f64s(turn.y));
    for (beams, ranges_m) in beams.iter().zip(ranges_m) {
        let (x, _) = S::as_simd_f64s(&beams.x);
        let (y, _) = S::as_simd_f64s(&beams.y);
        let (ranges_m, _) = S::as_mut_simd_f64s(ranges_m);
        for ((&x, &y), range_m) in x.iter().zip(y).zip(ranges_m) {
            let along = [
                simd.sub_f64s(simd.mul_f64s(turn_x, x), simd.mul_f64s(turn_y, y)),
                simd.add_f64s(simd.mul_f64s(turn_y, x), simd.mul_f64s(turn_x, y)),
            ];
            let distance_m = outline.distance_m(simd, along);
            *range_m = simd.min_f64s(distance_m, *range_m);
        }
    }
}

/// From the beams' origin to the four sides of a box.
#[derive(Clone, Copy)]
struct BoxSides<S: Simd> {
    low: [S::f64s; 2],
    high: [S::f64s; 2],
}

impl<S: Simd> BoxSides<S> {
    #[inline(always)]
    fn new(simd: S, from: Vector, Footprint { length_m, width_m }: Footprint) -> Self {
        BoxSides {
            low: [
                simd.splat_f64s(-(length_m / 2.0) - from.x),
                simd.splat_f64s(-(width_m / 2.0) - from.y),
            ],
            high: [
                simd.splat_f64s(length_m / 2.0 - from.x),
                simd.splat_f64s(width_m / 2.0 - from.y),
            ],
        }
    }

    /// Where the lines enter and leave the strip between two sides.
    #[inline(always)]
    fn slab(&self, simd: S, along: [S::f64s; 2], axis: usize) -> (S::f64s, S::f64s) {
        let a = simd.div_f64s(self.low[axis], along[axis]);
        let b = simd.div_f64s(self.high[axis], along[axis]);
        // Not a number: the line runs along a side and never crosses the strip's edges.
        let crosses = simd.and_m64s(simd.equal_f64s(a, a), simd.equal_f64s(b, b));
        let (most, least) = (f64::INFINITY, f64::NEG_INFINITY);
        (
            simd.select_f64s(crosses, simd.min_f64s(a, b), simd.splat_f64s(least)),
            simd.select_f64s(crosses, simd.max_f64s(a, b), simd.splat_f64s(most)),
        )
    }
}

impl<S: Simd> Outline<S> for BoxSides<S> {
    #[inline(always)]
    fn distance_m(&self, simd: S, along: [S::f64s; 2]) -> S::f64s {
        let (near_x, far_x) = self.slab(simd, along, 0);
        let (near_y, far_y) = self.slab(simd, along, 1);
        let near = simd.max_f64s(near_x, near_y);
        let far = simd.min_f64s(far_x, far_y);
        let zero = simd.splat_f64s(0.0);
        let meets = simd.and_m64s(
            simd.less_than_or_equal_f64s(near, far),
            simd.greater_than_or_equal_f64s(far, zero),
        );
        let misses = simd.splat_f64s(f64::INFINITY);
        simd.select_f64s(meets, simd.max_f64s(near, zero), misses)
    }
}

/// A circle around the shape's origin.
#[derive(Clone, Copy)]
struct Circle<S: Simd> {
    from: [S::f64s; 2],
    /// Square of the radius less that of the distance: positive inside, m².
    inside: S::f64s,
    is_inside: S::m64s,
}

impl<S: Simd> Circle<S> {
    #[inline(always)]
    fn new(simd: S, from: Vector, radius_m: f64) -> Self {
        let inside = simd.splat_f64s(radius_m * radius_m - from.norm_squared());
        Circle {
            from: [simd.splat_f64s(from.x), simd.splat_f64s(from.y)],
            inside,
            is_inside: simd.greater_than_or_equal_f64s(inside, simd.splat_f64s(0.0)),
        }
    }
}

impl<S: Simd> Outline<S> for Circle<S> {
    #[inline(always)]
    fn distance_m(&self, simd: S, along: [S::f64s; 2]) -> S::f64s {
        let zero = simd.splat_f64s(0.0);
        let x = simd.mul_f64s(self.from[0], along[0]);
        let y = simd.mul_f64s(self.from[1], along[1]);
        let closing = simd.neg_f64s(simd.add_f64s(x, y));
        let root = simd.add_f64s(simd.mul_f64s(closing, closing), self.inside);
        let ahead = simd.greater_than_or_equal_f64s(closing, zero);
        let meets = simd.and_m64s(
            simd.greater_than_or_equal_f64s(root, zero),
            simd.or_m64s(ahead, self.is_inside),
        );
        let near = simd.sub_f64s(closing, simd.sqrt_f64s(root));
        let misses = simd.splat_f64s(f64::INFINITY);
        simd.select_f64s(meets, simd.max_f64s(near, zero), misses)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use pulp::{Arch, WithSimd};

    use super::*;

    /// The plain formula: distance along a unit vector from a point to a shape's edge,
    /// both in the shape's frame; 0 from inside.
    fn distance_m(shape: &Shape, from: Vector, along: Vector) -> Option<f64> {
        match shape {
            Shape::Box(Footprint { length_m, width_m }) => {
                let (near_x, far_x) = slab(from.x, along.x, length_m / 2.0);
                let (near_y, far_y) = slab(from.y, along.y, width_m / 2.0);
                let (near, far) = (near_x.max(near_y), far_x.min(far_y));
                (near <= far && far >= 0.0).then_some(near.max(0.0))
            }
            Shape::Disc { radius_m } => {
                let closing = -from.dot(&along);
                let inside = radius_m * radius_m - from.norm_squared();
                let root = closing * closing + inside;
                if root < 0.0 || (closing < 0.0 && inside < 0.0) {
                    return None;
                }
                Some((closing - root.sqrt()).max(0.0))
            }
        }
    }

    /// Where a line enters and leaves the strip between -half and half.
    fn slab(from: f64, along: f64, half: f64) -> (f64, f64) {
        // A line along the strip never crosses its edges: division by zero gives
        // infinities of the right sign, except on the edge itself.
        let (a, b) = ((-half - from) / along, (half - from) / along);
        if a.is_nan() || b.is_nan() {
            return (f64::NEG_INFINITY, f64::INFINITY);
        }
        (a.min(b), a.max(b))
    }

    struct Shot<'a>(&'a Target, &'a Beams, &'a mut [f64; CHUNK]);

    impl WithSimd for Shot<'_> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            let Shot(target, beams, ranges_m) = self;
            shoot(simd, target, &[*beams], std::slice::from_mut(ranges_m));
        }
    }

    fn compare(target: &Target, beams: &Beams) -> Result<(), TestCaseError> {
        for arch in [Arch::new(), Arch::Scalar] {
            let mut ranges_m = [50.0; CHUNK];
            arch.dispatch(Shot(target, beams, &mut ranges_m));
            for (k, range_m) in ranges_m.iter().enumerate() {
                let (beam, turn) = (Vector::new(beams.x[k], beams.y[k]), target.turn);
                let along = Vector::new(
                    turn.x * beam.x - turn.y * beam.y,
                    turn.y * beam.x + turn.x * beam.y,
                );
                let plain_m = distance_m(&target.shape, target.from, along).unwrap_or(50.0);
                // Zero has two signs, and the formula leaves open which one it gives.
                let same = range_m.to_bits() == plain_m.min(50.0).to_bits()
                    || (*range_m == 0.0 && plain_m == 0.0);
                prop_assert!(same, "{range_m} for {plain_m}, {target:?}, {along}");
            }
        }
        Ok(())
    }

    /// Numbers that meet edges, corners and axes exactly, and any others.
    fn coordinate() -> impl Strategy<Value = f64> {
        prop_oneof![
            prop::sample::select(vec![-2.0, -1.0, -0.0, 0.0, 1.0, 2.0, 4.0]),
            -60.0..60.0,
        ]
    }

    fn unit() -> impl Strategy<Value = f64> {
        prop_oneof![prop::sample::select(vec![-1.0, -0.0, 0.0, 1.0]), -1.0..1.0]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(4000))]

        #[test]
        fn every_beam_has_the_plain_formulas_bits(
            is_box: bool,
            from in (coordinate(), coordinate()),
            turn in (unit(), unit()),
            x in prop::array::uniform8(unit()),
            y in prop::array::uniform8(unit()),
        ) {
            let shape = match is_box {
                true => Shape::Box(Footprint { length_m: 4.0, width_m: 2.0 }),
                false => Shape::Disc { radius_m: 1.0 },
            };
            let target = Target {
                shape,
                from: Vector::new(from.0, from.1),
                turn: Vector::new(turn.0, turn.1),
            };
            compare(&target, &Beams { x, y })?;
        }
    }
}
