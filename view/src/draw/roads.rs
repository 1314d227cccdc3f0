//! Draws the ground: sidewalks, lanes, painted lines, the route and its checkpoints.

use sim::World;
use sim::lane::{Curve, Lane, LineColor, LineType};
use sim::road::{Network, RoadId};
use vehicle::Point;

use super::canvas::{Canvas, Stroke};
use super::palette;

/// Maximum distance between points of an arc, m: at a radius of 10 m the chord deviates by
/// 3 cm.
const ARC_STEP_M: f64 = 1.5;
/// Lengths of dash and gap of a broken line, m.
const BROKEN_M: [f64; 2] = [2.0, 4.0];
/// Widths of painted lines and of road edges, m.
const LINE_M: f64 = 0.18;
const EDGE_M: f64 = 0.3;
/// Width of the outline that closes the seams between adjacent lanes, m.
const SEAM_M: f64 = 0.12;
/// Radius of the disc with a checkpoint's number, m, and its minimum, px.
const MARK_M: f64 = 1.5;
const MARK_MIN_PX: f64 = 8.5;

/// Points along a lane at a lateral offset, m, positive to the right.
fn along(lane: &Lane, lateral_m: f64) -> Vec<Point> {
    let steps = match lane.curve {
        Curve::Straight(_) | Curve::Taper(_) => 1,
        Curve::Arc(_) => (lane.length_m / ARC_STEP_M).ceil().max(1.0) as usize,
    };
    (0..=steps)
        .map(|step| lane.position(lane.length_m * step as f64 / steps as f64, lateral_m))
        .collect()
}

/// The corners of a polygon, with the first one repeated at the end.
fn closed(corners: &[Point]) -> Vec<Point> {
    corners.iter().chain(corners.first()).copied().collect()
}

fn outline(lane: &Lane) -> Vec<Point> {
    let mut corners = along(lane, lane.width_m / 2.0);
    corners.extend(along(lane, -lane.width_m / 2.0).into_iter().rev());
    corners
}

/// Draws everything that does not move.
pub fn draw(canvas: &mut Canvas, world: &World) {
    let network = &world.map().network;
    for piece in world.sidewalks().pieces() {
        canvas.area(piece, palette::SIDEWALK, 1.0);
        canvas.line(&closed(piece), Stroke::solid(palette::SIDEWALK, SEAM_M));
    }
    let surface = |canvas: &mut Canvas, lane: &Lane, color| {
        canvas.area(&outline(lane), color, 1.0);
        // A thin outline of the same colour closes the seams between lanes.
        canvas.line(&closed(&outline(lane)), Stroke::solid(color, SEAM_M));
    };
    for lane in network.lanes() {
        surface(canvas, lane, palette::ASPHALT);
    }
    let route = world.navigator().roads();
    for lane in route.iter().flat_map(|&road| network.lanes_of(road)) {
        surface(canvas, lane, palette::ROUTE);
    }
    for road in (0..network.roads().len()).map(|index| RoadId(index as u16)) {
        draw_lines(canvas, network.lanes_of(road));
    }
    draw_checkpoints(canvas, network, route);
}

/// Draws the lines of a road's lanes; only the last lane has a line on its right.
fn draw_lines(canvas: &mut Canvas, lanes: &[Lane]) {
    for (index, lane) in lanes.iter().enumerate() {
        let color = match lane.left_color {
            LineColor::White => palette::WHITE_LINE,
            LineColor::Yellow => palette::YELLOW_LINE,
        };
        draw_line(canvas, lane, (lane.lines[0], color), -lane.width_m / 2.0);
        if index + 1 == lanes.len() {
            let line = (lane.lines[1], palette::WHITE_LINE);
            draw_line(canvas, lane, line, lane.width_m / 2.0);
        }
    }
}

fn draw_line(canvas: &mut Canvas, lane: &Lane, (line, color): (LineType, &str), lateral_m: f64) {
    let stroke = match line {
        LineType::None => return,
        LineType::Broken => Stroke {
            dash_m: Some(BROKEN_M),
            opacity: 0.8,
            ..Stroke::solid(color, LINE_M)
        },
        LineType::Continuous => Stroke::solid(color, LINE_M),
        LineType::Side => Stroke::solid(color, EDGE_M),
    };
    canvas.line(&along(lane, lateral_m), stroke);
}

/// Draws the end of each road of the route; the last one is the goal.
fn draw_checkpoints(canvas: &mut Canvas, network: &Network, route: &[RoadId]) {
    for (index, &road) in route.iter().enumerate() {
        let lanes = network.lanes_of(road);
        let (Some(first), Some(last)) = (lanes.first(), lanes.last()) else {
            continue;
        };
        let left = first.position(first.length_m, -first.width_m / 2.0);
        let right = last.position(last.length_m, last.width_m / 2.0);
        let is_goal = index + 1 == route.len();
        let width_m = if is_goal { 1.1 } else { 0.35 };
        canvas.line(&[left, right], Stroke::solid(palette::CHECKPOINT, width_m));
        // Beside the road, where no path covers it; readable at any scale.
        let scale_px_per_m = canvas.scale_px_per_m();
        let radius_m = MARK_M.max(MARK_MIN_PX / scale_px_per_m);
        let beside = right + (right - left).normalize() * (radius_m + 1.1);
        canvas.disc(beside, radius_m, palette::CHECKPOINT);
        let size_px = 1.25 * radius_m * scale_px_per_m;
        let text = (index + 1).to_string();
        canvas.label(beside, &text, (palette::INK, size_px));
    }
}
