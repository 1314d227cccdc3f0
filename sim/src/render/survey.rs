//! The parts that do not move: sidewalks, lanes and painted lines, as polygons.

use shm_config::palette::{self, Rgb};
use vehicle::{Point, Vector};

use crate::World;
use crate::lane::{Curve, Lane, LineColor, LineType};
use crate::road::RoadId;

/// Corners of an arc lie this far apart at most, m: a chord of a 10 m radius is
/// then off by 1 cm.
const ARC_STEP_M: f64 = 1.0;
/// Dash and gap of a broken line, m.
const DASH_M: f64 = 2.0;
const GAP_M: f64 = 4.0;
/// Widths of painted lines and of a road's edge, m: a third wider than in reality, so
/// that they are visible where a metre is eight pixels.
const LINE_M: f64 = 0.2;
const EDGE_M: f64 = 0.3;

/// How far a lane's surface extends past its edge on each side, m: the chords of two
/// lanes of a bend do not meet, and the ground would be visible between them.
const OVERLAP_M: f64 = 0.04;

/// A polygon of the world, counter-clockwise.
pub struct Area {
    /// Its corners.
    pub corners_world: Vec<Point>,
    /// A point in the middle, and the largest distance of a corner from it, m.
    pub middle_world: Point,
    /// See `middle_world`.
    pub radius_m: f64,
}

impl Area {
    fn new(corners_world: Vec<Point>) -> Area {
        let count = corners_world.len().max(1) as f64;
        let sum = corners_world
            .iter()
            .fold(Vector::zeros(), |sum, corner| sum + corner.coords);
        let middle_world = Point::from(sum / count);
        let away = |corner: &Point| (corner - middle_world).norm();
        Area {
            radius_m: corners_world.iter().map(away).fold(0.0, f64::max),
            middle_world,
            corners_world,
        }
    }
}

/// Areas of one colour.
pub struct Layer {
    /// Their colour.
    pub color: Rgb,
    /// The polygons; all have the same orientation.
    pub areas: Vec<Area>,
}

/// The ground of an episode, from the lowest layer up.
pub fn survey(world: &World) -> Vec<Layer> {
    let network = &world.map().network;
    let sidewalks = world.sidewalks().pieces();
    let mut layers = vec![
        Layer {
            color: palette::SIDEWALK,
            areas: sidewalks.map(|piece| Area::new(piece.to_vec())).collect(),
        },
        Layer {
            color: palette::ROAD,
            areas: network.lanes().iter().map(surface).collect(),
        },
    ];
    let lines = [
        palette::LINE_BROKEN,
        palette::LINE_SOLID,
        palette::LINE_CENTRE,
    ];
    layers.extend(lines.map(|color| Layer {
        color,
        areas: Vec::new(),
    }));
    for road in (0..network.roads().len()).map(|index| RoadId(index as u16)) {
        paint_road(network.lanes_of(road), &mut layers);
    }
    layers
}

/// A line on the right is only painted for a road's last lane.
fn paint_road(lanes: &[Lane], layers: &mut [Layer]) {
    for (index, lane) in lanes.iter().enumerate() {
        let left = match lane.left_color {
            LineColor::White => palette::LINE_SOLID,
            LineColor::Yellow => palette::LINE_CENTRE,
        };
        paint_line(lane, (lane.lines[0], left), -lane.width_m / 2.0, layers);
        if index + 1 == lanes.len() {
            let line = (lane.lines[1], palette::LINE_SOLID);
            paint_line(lane, line, lane.width_m / 2.0, layers);
        }
    }
}

fn paint_line(lane: &Lane, (line, solid): (LineType, Rgb), at_m: f64, layers: &mut [Layer]) {
    let whole = [0.0, lane.length_m];
    let (color, areas) = match line {
        LineType::None => return,
        LineType::Broken => (palette::LINE_BROKEN, dashes(lane, at_m)),
        LineType::Continuous => (solid, vec![strip(lane, whole, [at_m, LINE_M])]),
        LineType::Side => (solid, vec![strip(lane, whole, [at_m, EDGE_M])]),
    };
    if let Some(layer) = layers.iter_mut().find(|layer| layer.color == color) {
        layer.areas.extend(areas);
    }
}

fn dashes(lane: &Lane, at_m: f64) -> Vec<Area> {
    let count = (lane.length_m / (DASH_M + GAP_M)).ceil() as usize;
    let dash = |index: usize| {
        // Half a gap first: where two lanes meet there is a whole one.
        let from_m = GAP_M / 2.0 + index as f64 * (DASH_M + GAP_M);
        let to_m = (from_m + DASH_M).min(lane.length_m);
        (from_m < to_m).then(|| strip(lane, [from_m, to_m], [at_m, LINE_M]))
    };
    (0..count).filter_map(dash).collect()
}

fn surface(lane: &Lane) -> Area {
    let ends_m = [-OVERLAP_M, lane.length_m + OVERLAP_M];
    strip(lane, ends_m, [0.0, lane.width_m + 2.0 * OVERLAP_M])
}

/// A strip along a lane, from and to longitudinal coordinates, around a lateral
/// one (right positive) and that wide, m.
fn strip(lane: &Lane, [from_m, to_m]: [f64; 2], [at_m, width_m]: [f64; 2]) -> Area {
    let steps = match lane.curve {
        Curve::Straight(_) | Curve::Taper(_) => 1,
        Curve::Arc(_) => ((to_m - from_m) / ARC_STEP_M).ceil().max(1.0) as usize,
    };
    let along_m = |step: usize| from_m + (to_m - from_m) * step as f64 / steps as f64;
    let side = |step: usize, sign: f64| lane.position(along_m(step), at_m + sign * width_m / 2.0);
    let right = (0..=steps).map(|step| side(step, 1.0));
    let left = (0..=steps).rev().map(|step| side(step, -1.0));
    Area::new(right.chain(left).collect())
}
