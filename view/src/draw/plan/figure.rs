//! The figure of a plan in the body frame, in metres: x (forward) points right, y (left)
//! points up.

use planner::Grid;
use shm_config::message::{Observation, Plan};
use svg::Document;
use svg::node::element::{
    Circle, ClipPath, Definitions, Group, LinearGradient, Path, Polygon, Rectangle, Stop,
};
use vehicle::{Point, Pose, pose};

use super::axes::{axes, colour_bar};
use super::view::{AXIS_PX, LEFT_PX, RIGHT_PX, View, WIDTH_PX};
use super::{Planned, branches, cells};
use crate::draw::canvas::{HEAD_PX, px};
use crate::draw::frame::{self, ROW_PX, Symbol, key, legend, star};
use crate::draw::palette;
use stack::driver::DriverKind;

/// Distance between drawn footprints, m: they overlap, but each is visible.
const FOOTPRINTS_M: f64 = 1.5;

/// Distance of the arrow to a goal outside the picture from the edge, px.
const EDGE_PX: f64 = 26.0;

/// The whole picture.
pub(super) fn svg(planned: &Planned) -> String {
    let Planned {
        planner,
        plan,
        observation,
        config,
        ..
    } = planned;
    // A method without a grid is drawn on the grid of the paper's method.
    let mut own = Grid::new(&config.planner).of(config.vehicle.footprint());
    own.fill(observation);
    let grid = planner.grid().unwrap_or(&own);
    // If the direct path was free, no search took place and there is no tree.
    let tree = match plan.actions().is_empty() && plan.iterations > 0 {
        true => recorder::standard::branches(planner),
        false => None,
    };
    let view = View::of(grid, plan);
    let mut ground = Group::new()
        .set("clip-path", "url(#ground)")
        .set("stroke-linecap", "round")
        .set("stroke-linejoin", "round")
        .add(free(&view, grid))
        .add(blocked(&view, grid));
    let mut around = frame::head(&planned.title, &facts(planned))
        .add(axes(&view))
        .add(keys(planned, &view));
    if let Some(tree) = &tree {
        let greatest_m = branches::greatest_cost_m(tree);
        ground = ground.add(branches::draw(&view, tree, greatest_m));
        around = around.add(colour_bar(&view, greatest_m));
    }
    ground = ground.add(returns(&view, observation));
    if plan.actions().is_empty() {
        ground = ground.add(goal_ball(&view, plan, config.planner.goal_radius_m));
    }
    let footprint = |body: &Pose| config.vehicle.footprint().corners(body);
    if !plan.actions().is_empty() {
        for body in poses(plan) {
            let data = view.data(&footprint(&body), "Z");
            let outline = shape(data, palette::PATH, 0.07, palette::PATH);
            ground = ground.add(outline.set("stroke-opacity", 0.55));
        }
    }
    let ego = footprint(&Pose::identity());
    ground = ground.add(shape(view.data(&ego, "Z"), palette::CAR, 1.0, palette::INK));
    ground = ground.add(windscreen(&view)).add(way(&view, plan));
    ground = ground.add(goal(&view, plan));
    document(&view, ground, around)
}

/// A star at the goal; for a goal outside the picture, an arrow at the edge with the
/// distance to it.
fn goal(view: &View, plan: &Plan) -> Group {
    let goal_body = Point::new(plan.goal_x_body_m, plan.goal_y_body_m);
    let look = |element: Polygon| {
        element
            .set("fill", palette::PATH)
            .set("stroke", palette::FREE)
            .set("stroke-width", 2.5)
            .set("paint-order", "stroke")
    };
    let [x, y] = view.at(goal_body);
    if is_in_view(view, [x, y]) {
        return Group::new().add(look(star([x, y], 17.0)));
    }
    let edge = [
        x.clamp(LEFT_PX + EDGE_PX, LEFT_PX + WIDTH_PX - EDGE_PX),
        y.clamp(HEAD_PX + EDGE_PX, view.bottom_px() - EDGE_PX),
    ];
    let away = [x - edge[0], y - edge[1]];
    let missing_m = away[0].hypot(away[1]) / view.px_per_m;
    let turn_deg = away[1].atan2(away[0]).to_degrees();
    let arrow = Polygon::new()
        .set("points", "16,0 -12,-11 -6,0 -12,11")
        .set(
            "transform",
            format!(
                "translate({} {}) rotate({})",
                px(edge[0]),
                px(edge[1]),
                px(turn_deg)
            ),
        );
    let words = frame::text(
        &format!("goal {missing_m:.1} m further"),
        [edge[0] - 22.0, edge[1] + 5.0],
        15.0,
    );
    let words = words
        .set("text-anchor", "end")
        .set("stroke", palette::FREE)
        .set("stroke-width", 3)
        .set("paint-order", "stroke");
    Group::new().add(look(arrow)).add(words)
}

fn is_in_view(view: &View, [x, y]: [f64; 2]) -> bool {
    (LEFT_PX..=LEFT_PX + WIDTH_PX).contains(&x) && (HEAD_PX..=view.bottom_px()).contains(&y)
}

fn document(view: &View, ground: Group, around: Group) -> String {
    let width_px = LEFT_PX + WIDTH_PX + RIGHT_PX;
    let height_px = view.bottom_px() + AXIS_PX + ROW_PX + 20.0;
    let clip = ClipPath::new()
        .set("id", "ground")
        .add(plate([LEFT_PX, HEAD_PX], [WIDTH_PX, view.height_px()]));
    let mut costs = LinearGradient::new()
        .set("id", "costs")
        .set("x1", 0)
        .set("y1", 1)
        .set("x2", 0)
        .set("y2", 0);
    for index in 0..palette::COSTS.len() {
        let share = index as f64 / (palette::COSTS.len() - 1) as f64;
        costs = costs.add(
            Stop::new()
                .set("offset", px(share))
                .set("stop-color", palette::cost(share)),
        );
    }
    let document = Document::new()
        .set("viewBox", format!("0 0 {} {}", px(width_px), px(height_px)))
        .set("width", px(width_px))
        .set("height", px(height_px))
        .set("font-family", "Inter, 'Helvetica Neue', Arial, sans-serif")
        .add(Definitions::new().add(clip).add(costs))
        .add(plate([0.0, 0.0], [width_px, height_px]).set("fill", palette::PAPER))
        .add(plate([LEFT_PX, HEAD_PX], [WIDTH_PX, view.height_px()]).set("fill", palette::GROUND))
        .add(ground)
        .add(around);
    format!("{document}\n")
}

/// A rectangle by corner and size, px.
pub(super) fn plate([x, y]: [f64; 2], [width, height]: [f64; 2]) -> Rectangle {
    Rectangle::new()
        .set("x", px(x))
        .set("y", px(y))
        .set("width", px(width))
        .set("height", px(height))
}

fn facts(planned: &Planned) -> String {
    let Planned {
        plan,
        config,
        observation,
        ..
    } = planned;
    let method = DriverKind::of_method(config.planner.method).word();
    let mut facts = vec![method.to_string(), plan.outcome().word().into()];
    if plan.waypoint_count > 0 {
        facts.push(format!("path {:.2} m", plan.cost_m));
    }
    match plan.actions() {
        [] if plan.iterations == 0 && plan.nodes > 0 => {
            facts.push("the direct path is free: no search".into());
        }
        [] => facts.push(format!(
            "{} nodes of {} iterations",
            plan.nodes, plan.iterations
        )),
        actions => facts.push(format!(
            "{:.1} s ahead in {} actions",
            plan.action_step_s * actions.len() as f64,
            actions.len()
        )),
    }
    let side = match plan.goal_y_body_m < 0.0 {
        true => "right",
        false => "left",
    };
    facts.push(format!(
        "goal {:.1} m ahead, {:.1} m {side}",
        plan.goal_x_body_m,
        plan.goal_y_body_m.abs()
    ));
    facts.push(format!("car at {:.1} m/s", observation.ego.speed_mps));
    facts.join("   ·   ")
}

/// The part of the ground that the grid covers.
fn free(view: &View, grid: &Grid) -> Rectangle {
    let corner = view.at(Point::new(0.0, grid.y_max_m()));
    let size = [grid.x_max_m(), 2.0 * grid.y_max_m()].map(|m| m * view.px_per_m);
    plate(corner, size).set("fill", palette::FREE)
}

fn blocked(view: &View, grid: &Grid) -> Path {
    let [x, y] = view.at(Point::new(0.0, grid.y_max_m()));
    let px_per_cell = grid.cell_m() * view.px_per_m;
    let place = format!("translate({} {}) scale({px_per_cell:.5})", px(x), px(y));
    Path::new()
        .set("d", cells::occupied(grid))
        .set("transform", place)
        .set("fill", palette::OCCUPIED)
        // Cells are not whole pixels: without this their edges are blurred.
        .set("shape-rendering", "crispEdges")
}

/// The visible lidar returns, px.
fn returns_px<'a>(
    view: &'a View,
    observation: &'a Observation,
) -> impl Iterator<Item = [f64; 2]> + 'a {
    let fan = observation.fan();
    observation
        .ranges()
        .iter()
        .enumerate()
        .filter_map(move |(k, &range_m)| {
            let place = view.at(fan.point_body(k, f64::from(range_m)));
            (range_m < observation.lidar_max_m && is_in_view(view, place)).then_some(place)
        })
}

fn returns(view: &View, observation: &Observation) -> Group {
    let mut group = Group::new().set("fill", palette::SCAN);
    for place in returns_px(view, observation) {
        group = group.add(disc(place, 2.8));
    }
    group
}

/// A circle by centre and radius, px.
pub(super) fn disc([x, y]: [f64; 2], radius_px: f64) -> Circle {
    Circle::new()
        .set("cx", px(x))
        .set("cy", px(y))
        .set("r", px(radius_px))
}

fn keys(planned: &Planned, view: &View) -> Group {
    let plan = &planned.plan;
    let mut keys = match plan.actions().is_empty() {
        true => vec![
            key(Symbol::Line, palette::PATH, "path"),
            key(Symbol::Star, palette::PATH, "goal with its ball"),
        ],
        false => vec![
            key(Symbol::Line, palette::PATH, "predicted trajectory"),
            key(Symbol::Box, palette::FOOTPRINT, "ego as predicted"),
            key(Symbol::Star, palette::PATH, "goal"),
        ],
    };
    keys.extend([
        key(Symbol::Box, palette::FREE, "free"),
        key(Symbol::Box, palette::OCCUPIED, "occupied"),
        key(Symbol::Box, palette::CAR, "ego"),
    ]);
    if returns_px(view, &planned.observation).next().is_some() {
        keys.push(key(Symbol::Disc, palette::SCAN, "lidar return"));
    }
    let top = view.bottom_px() + AXIS_PX + 12.0;
    legend(&keys, [LEFT_PX, top], LEFT_PX + WIDTH_PX + RIGHT_PX).0
}

fn goal_ball(view: &View, plan: &Plan, radius_m: f64) -> Circle {
    let goal_body = Point::new(plan.goal_x_body_m, plan.goal_y_body_m);
    disc(view.at(goal_body), radius_m * view.px_per_m)
        .set("fill", palette::PATH)
        .set("fill-opacity", 0.14)
        .set("stroke", palette::PATH)
        .set("stroke-width", 2)
        .set("stroke-dasharray", "7 6")
}

/// The planned path or trajectory, with a light outline.
fn way(view: &View, plan: &Plan) -> Group {
    let points: Vec<Point> = plan.waypoints().iter().map(|w| w.point()).collect();
    let mut group = Group::new();
    if points.len() < 2 {
        return group;
    }
    let data = view.data(&points, "");
    for (color, width) in [(palette::FREE, 9.0), (palette::PATH, 5.0)] {
        group = group.add(
            Path::new()
                .set("d", data.clone())
                .set("fill", "none")
                .set("stroke", color)
                .set("stroke-width", width),
        );
    }
    for point in points {
        let place = disc(view.at(point), 5.0).set("fill", palette::PATH);
        group = group.add(place.set("stroke", palette::FREE).set("stroke-width", 2));
    }
    group
}

/// Poses of the car along the trajectory, every [`FOOTPRINTS_M`] and at the end.
fn poses(plan: &Plan) -> Vec<Pose> {
    let points: Vec<Point> = plan.waypoints().iter().map(|w| w.point()).collect();
    let mut poses = Vec::new();
    let mut apart_m = 0.0;
    for (index, [from, to]) in points.array_windows().enumerate() {
        let step = to - from;
        apart_m += step.norm();
        let is_last = index + 2 == points.len();
        // A standing car has no direction of motion.
        if step.norm() > 1e-3 && (is_last || apart_m >= FOOTPRINTS_M) {
            poses.push(pose(to.x, to.y, step.y.atan2(step.x)));
            apart_m = 0.0;
        }
    }
    poses
}

fn shape(data: String, color: &str, opacity: f64, rim: &str) -> Path {
    Path::new()
        .set("d", data)
        .set("fill", color)
        .set("fill-opacity", opacity)
        .set("stroke", rim)
        .set("stroke-width", 1.4)
}

/// The windscreen, which marks the car's front.
fn windscreen(view: &View) -> Path {
    let corners = [(0.95, 0.72), (0.95, -0.72), (0.3, -0.6), (0.3, 0.6)];
    let corners = corners.map(|(x_m, y_m)| Point::new(x_m, y_m));
    Path::new()
        .set("d", view.data(&corners, "Z"))
        .set("fill", palette::INK)
        .set("fill-opacity", 0.8)
}
