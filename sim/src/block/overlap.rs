//! Tests whether a new lane would overlap an earlier block, with the simulator's own
//! test and its quirks, because the test decides which samples are refused. Source:
//! `utils/pg/utils.py` of MetaDrive.

use std::f64::consts::FRAC_PI_2;

use vehicle::{Point, Vector};

use super::builder::Draft;
use crate::lane::{Arc, Curve, Lane, Turn};
use crate::surface::Bounds;

/// The block cannot be built with these parameters, because it would overlap an earlier
/// one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Overlap;

/// Width kept free beside a road for its sidewalk, m.
const BESIDE_M: f64 = 3.0;
/// How far inside its ends the contour of a road is measured, m.
const INSET_M: f64 = 0.1;

/// Refuses a lane if one of its points lies on an earlier lane. The points are sampled
/// every metre, `offset` half widths to the right of the centre line.
pub(super) fn check(around: &[&Draft], lane: &Lane, offset: f64) -> Result<(), Overlap> {
    let own = contour(std::slice::from_ref(lane));
    let near = around
        .iter()
        .flat_map(|draft| &draft.roads)
        .filter(|road| road.contour.overlaps(&own));
    let mut samples: Vec<Point> = Vec::new();
    for road in near {
        if samples.is_empty() {
            let lateral_m = offset * lane.width_m / 2.0;
            let count = lane.length_m as u32;
            samples.extend((1..count).map(|i| lane.position(f64::from(i), lateral_m)));
        }
        for other in &road.lanes {
            // The box is tested first, because an arc costs an arc tangent for each
            // point.
            let bounds = other.surface_bounds();
            let hit = |&point: &Point| bounds.contains(point, 1e-6) && is_on(other, point);
            if samples.iter().any(hit) {
                return Err(Overlap);
            }
        }
    }
    Ok(())
}

fn is_on(lane: &Lane, point_world: Point) -> bool {
    let (longitudinal_m, lateral_m) = lane.local_coordinates(point_world);
    lateral_m.abs() <= lane.width_m / 2.0
        && longitudinal_m >= 0.0
        && longitudinal_m <= lane.length_m
}

/// The axis-aligned box around a road and its sidewalks.
pub(super) fn contour(lanes: &[Lane]) -> Bounds {
    let mut bounds = Bounds::EMPTY;
    let (Some(first), Some(last)) = (lanes.first(), lanes.last()) else {
        return bounds;
    };
    for (lane, side) in [(first, -1.0), (last, 1.0)] {
        let lateral_m = side * (lane.width_m / 2.0 + BESIDE_M);
        bounds.include(lane.position(INSET_M, lateral_m));
        bounds.include(lane.position(lane.length_m - INSET_M, lateral_m));
        // The first lane decides which of the two shapes a road has.
        if let (Curve::Arc(_), Curve::Arc(arc)) = (&first.curve, &lane.curve) {
            include_extremes(&mut bounds, arc, lateral_m);
        }
    }
    bounds
}

/// The points of an arc furthest along the axes. The simulator takes them on the other
/// side of the lane than the end points, and so does this code.
fn include_extremes(bounds: &mut Bounds, arc: &Arc, lateral_m: f64) {
    let sign = arc.turn.sign();
    let quarter = (arc.start_phase_rad / FRAC_PI_2).floor() * FRAC_PI_2;
    let first_rad = match arc.turn {
        Turn::Left => quarter,
        Turn::Right => quarter + FRAC_PI_2,
    };
    for k in 0..4 {
        let phase_rad = first_rad + f64::from(k) * FRAC_PI_2 * sign;
        if sign * phase_rad > sign * arc.end_phase_rad() {
            break;
        }
        let (sin, cos) = phase_rad.sin_cos();
        let reach_m = arc.radius_m - lateral_m * sign;
        bounds.include(arc.center_world + reach_m * Vector::new(cos, sin));
    }
}
