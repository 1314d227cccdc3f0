//! One moment of a recorded drive from above, in pixels: road, scan, plan, both proposals,
//! the path so far, and which driver drives.

use shm_config::message::{Driver, Step};
use sim::World;
use vehicle::{Footprint, Point, pose};

use super::canvas::{Canvas, Stroke};
use super::palette;
use super::raster::{Align, Pen, Raster};
use super::{ride, roads};
use crate::live::scene::{ProposalScene, Scene};

/// Height of the band below the picture, px.
const BAND_PX: f64 = 34.0;
/// Distance of texts from the edges, px.
const SIDE_PX: f64 = 10.0;
/// Size of texts, px.
const TEXT_PX: f64 = 15.0;
/// Opacity of the band after the present moment.
const AHEAD: f64 = 0.3;
/// Widths of path, plan and proposals, m.
const TRAIL_M: f64 = 0.5;
const PLAN_M: f64 = 0.3;
const PROPOSAL_M: f64 = 0.35;
/// Spacings of the marks of the band, s.
const MARKS_S: [f64; 8] = [1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 300.0, 1200.0];
/// Marks of a band at most.
const MARKS_MAX: f64 = 9.0;

/// Size of the picture and of what it shows.
#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Width and height, px.
    pub size_px: [u32; 2],
    /// Metres from left to right.
    pub across_m: f64,
}

/// Which driver drove when, s.
#[derive(Clone, Debug, Default)]
pub struct Band {
    /// From, to and driver; in order of time.
    pub parts: Vec<(f64, f64, Driver)>,
}

/// What is drawn.
pub struct Moment<'a> {
    /// The step.
    pub step: &'a Step,
    /// The same, as the live page draws it.
    pub scene: &'a Scene,
    /// The world at the step's observation, when it could be rebuilt; otherwise the road is
    /// drawn as the planner understands it, and other cars where they were seen.
    pub world: Option<&'a World>,
    /// Where the car was, and which driver drove it there.
    pub trail: &'a [(Point, Driver)],
    /// Of the car.
    pub footprint: Footprint,
    /// Seconds since the recording's beginning.
    pub time_s: f64,
}

/// Draws a moment with the band below it: row by row from the top, red, green and blue;
/// `None` when the picture has no pixels, or more than memory holds.
pub fn draw(moment: &Moment, band: &Band, shape: Shape) -> Option<Vec<u8>> {
    let ego = &moment.step.observation.ego;
    let at = Point::new(ego.x_world_m, ego.y_world_m);
    let scale = f64::from(shape.size_px[0]) / shape.across_m;
    // Whole pixels: what stands on the ground looks the same in each frame.
    let snap = |value_m: f64| (value_m * scale).round() / scale;
    // The band covers the lower edge.
    let center = Point::new(snap(at.x), snap(at.y - BAND_PX / 2.0 / scale));
    let mut canvas = Canvas::pixels(center, shape.across_m, shape.size_px)?;
    ground(&mut canvas, moment);
    trail(&mut canvas, moment.trail);
    ride::draw_scan(&mut canvas, &moment.step.observation);
    if let Some(world) = moment.world {
        ride::draw_bodies(&mut canvas, world);
    }
    let world_from_body = pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
    let place = |[x, y]: [f64; 2]| world_from_body * Point::new(x, y);
    let proposals = [
        (&moment.scene.policy, Driver::Policy),
        (&moment.scene.expert, Driver::Expert),
    ];
    for (proposal, driver) in proposals {
        if let Some(proposal) = proposal {
            draw_proposal(&mut canvas, proposal, driver, place);
        }
    }
    plan(&mut canvas, moment.step);
    let driver = moment.step.driver();
    let corners = moment.footprint.corners(&world_from_body);
    ride::draw_box(
        &mut canvas,
        corners,
        (palette::driver(driver), palette::INK),
    );
    let mut raster = canvas.into_raster()?;
    words(&mut raster, moment, shape.size_px);
    draw_band(&mut raster, band, moment.time_s, shape.size_px);
    Some(raster.rgb())
}

/// The road: the world's own, or its edges as the planner understands them.
fn ground(canvas: &mut Canvas, moment: &Moment) {
    if let Some(world) = moment.world {
        return roads::draw(canvas, world);
    }
    let [x, y, heading_rad] = moment.scene.ego_world;
    let world_from_body = pose(x, y, heading_rad);
    let edge = |points: &[[f64; 2]]| -> Vec<Point> {
        let points = points.iter();
        points
            .map(|[x, y]| world_from_body * Point::new(*x, *y))
            .collect()
    };
    let [left, right] = &moment.scene.edges;
    let (left, right) = (edge(left), edge(right));
    let corners: Vec<Point> = left.iter().chain(right.iter().rev()).copied().collect();
    if corners.len() > 2 {
        canvas.area(&corners, palette::ASPHALT, 1.0);
    }
    for edge in [&left, &right] {
        canvas.line(edge, Stroke::solid(palette::WHITE_LINE, 0.3));
    }
    for track in &moment.scene.tracks {
        let at = world_from_body * Point::new(track.at[0], track.at[1]);
        canvas.disc(at, track.radius_m.max(0.5), palette::TRAFFIC);
    }
}

/// The path so far, a colour for each driver.
fn trail(canvas: &mut Canvas, trail: &[(Point, Driver)]) {
    let mut begin = 0;
    for run in trail.chunk_by(|a, b| a.1 == b.1) {
        let end = begin + run.len();
        // Up to the first point of the next driver, so that no gap remains.
        let part = &trail[begin..(end + 1).min(trail.len())];
        let points: Vec<Point> = part.iter().map(|(at, _)| *at).collect();
        canvas.line(&points, Stroke::solid(palette::driver(run[0].1), TRAIL_M));
        begin = end;
    }
}

fn draw_proposal(
    canvas: &mut Canvas,
    proposal: &ProposalScene,
    driver: Driver,
    place: impl Fn([f64; 2]) -> Point,
) {
    let points: Vec<Point> = proposal.rollout.iter().map(|at| place(*at)).collect();
    canvas.line(&points, Stroke::solid(palette::driver(driver), PROPOSAL_M));
    if let Some(end) = points.last() {
        canvas.disc(*end, PROPOSAL_M, palette::driver(driver));
    }
}

fn plan(canvas: &mut Canvas, step: &Step) {
    if step.plan_age_ns == u64::MAX {
        return;
    }
    let plan = &step.plan;
    let world_from_plan = pose(
        plan.origin_x_world_m,
        plan.origin_y_world_m,
        plan.origin_heading_world_rad,
    );
    let points: Vec<Point> = plan
        .waypoints()
        .iter()
        .map(|at| world_from_plan * Point::new(at.x_body_m, at.y_body_m))
        .collect();
    let stroke = Stroke {
        dash_m: Some([1.0, 0.8]),
        ..Stroke::solid(palette::PLAN, PLAN_M)
    };
    canvas.line(&points, stroke);
    if let Some(end) = points.last() {
        canvas.ring(*end, 0.8, Stroke::solid(palette::PLAN, 0.25));
    }
}

/// Driver and reason at the left, time and speed at the right.
fn words(raster: &mut Raster, moment: &Moment, [width, _]: [u32; 2]) {
    let driver = moment.step.driver();
    let (word, top) = (driver.word(), SIDE_PX + 13.0);
    let wide = Raster::width_px(word, TEXT_PX) + 18.0;
    let (left, right) = (SIDE_PX, SIDE_PX + wide);
    let pill = [
        [left, top - 13.0],
        [right, top - 13.0],
        [right, top + 13.0],
        [left, top + 13.0],
    ];
    raster.area(&pill, palette::driver(driver), 1.0);
    let place = ([(left + right) / 2.0, top], Align::Center);
    raster.text(place, word, TEXT_PX, (palette::INK, None));
    let rimmed = (palette::INK, Some(palette::PAPER));
    let place = ([right + 10.0, top], Align::Left);
    raster.text(place, moment.scene.reason, TEXT_PX, rimmed);
    let text = format!("{:.1} m/s   {:.1} s", moment.scene.speed_mps, moment.time_s);
    let place = ([f64::from(width) - SIDE_PX, top], Align::Right);
    raster.text(place, &text, TEXT_PX, rimmed);
}

/// The band over time: which driver drives; what is still to come is paler.
fn draw_band(raster: &mut Raster, band: &Band, now_s: f64, [width, height]: [u32; 2]) {
    let (Some(first), Some(last)) = (band.parts.first(), band.parts.last()) else {
        return;
    };
    let (width, height) = (f64::from(width), f64::from(height));
    let (top, bottom) = (height - BAND_PX, height);
    let span_s = (last.1 - first.0).max(1e-9);
    let x = |time_s: f64| (time_s - first.0) / span_s * width;
    let block =
        |raster: &mut Raster, from: f64, to: f64, [top, bottom]: [f64; 2], color, opacity| {
            let corners = [[from, top], [to, top], [to, bottom], [from, bottom]];
            raster.area(&corners, color, opacity);
        };
    block(raster, 0.0, width, [top, bottom], palette::INK, 1.0);
    let rows = [top + 4.0, top + 16.0];
    for (from_s, to_s, driver) in &band.parts {
        let color = palette::driver(*driver);
        let middle = now_s.clamp(*from_s, *to_s);
        block(raster, x(*from_s), x(middle), rows, color, 1.0);
        block(raster, x(middle), x(*to_s), rows, color, AHEAD);
    }
    let apart = MARKS_S.iter().find(|apart| span_s / **apart <= MARKS_MAX);
    let apart_s = apart.copied().unwrap_or(span_s);
    let mut mark_s = (first.0 / apart_s).ceil() * apart_s;
    while mark_s < last.1 {
        let text = format!("{mark_s:.0} s");
        let at = x(mark_s);
        // Not at the edges, where it would be cut.
        if at > 14.0 && at < width - 14.0 {
            let place = ([at, bottom - 8.0], Align::Center);
            raster.text(place, &text, 10.5, (palette::GROUND, None));
        }
        mark_s += apart_s;
    }
    let pen = Pen {
        color: palette::EGO,
        width_px: 2.0,
        opacity: 1.0,
        dash_px: None,
    };
    let at = x(now_s).clamp(1.0, width - 1.0);
    raster.line(&[[at, top + 1.0], [at, top + 19.0]], pen);
}
