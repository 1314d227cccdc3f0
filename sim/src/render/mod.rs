//! Pictures of the world, drawn in software: from above, or from above the driver's
//! seat.
//!
//! The ground is drawn as polygons by colour, the bodies as a few convex solids each,
//! from the farthest to the nearest. The body frame is that of the observation: the ego
//! at the pose that is observed, all other bodies at the pose of beams and contacts.

mod canvas;
mod solids;
mod survey;

use shm_config::message::{Camera, View};
use shm_config::palette;
use vehicle::{Point, Vector};

use crate::World;
use crate::contact::Placed;
use canvas::{Canvas, Outline};
use solids::{Face, Model, Rim, Solid};
use survey::{Layer, survey};

/// Bodies further away are not drawn, m: a car is two pixels wide there.
const REACH_M: f64 = 300.0;
/// How much darker the ground is under a body.
const SHADOW: f64 = 0.4;
/// Widest rim of a face, pixels, and its width on the body, m.
const RIM_MAX_PX: f64 = 1.2;
const RIM_M: f64 = 0.05;
/// Smallest drawn size from above, pixels: a cone of 0.4 m would be three wide, a
/// barrier two.
const LEAST_PX: f64 = 5.0;

/// The requested picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shot {
    /// The view.
    pub view: View,
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    /// Share of the next sub-step that has passed, as for
    /// [`World::observe_between`].
    pub passed: f64,
}

/// A picture with its camera.
pub struct Picture<'a> {
    /// The camera that took it.
    pub camera: Camera,
    /// Width and height, pixels.
    pub size_px: [u32; 2],
    /// Row by row from the top, red, green and blue.
    pub rgb: &'a [u8],
}

/// Draws the episodes of one world, one after another.
#[derive(Default)]
pub struct Renderer {
    layers: Vec<Layer>,
    canvas: Option<Canvas>,
    /// Buffers for the polygons of a layer.
    outlines: Vec<Outline>,
}

/// The projection from the world to a picture.
struct Eye {
    camera: Camera,
    origin_world: Point,
    forward_world: Vector,
}

impl Eye {
    fn new(world: &World, shot: &Shot) -> Eye {
        let motion = world.ego_motion().between(shot.passed);
        Eye {
            camera: Camera::of(shot.view, shot.size_px),
            origin_world: motion.seen_position(),
            forward_world: motion.seen_forward(),
        }
    }

    /// A point at a height over the ground, in the ego's frame.
    fn body(&self, point_world: Point, z_m: f64) -> [f64; 3] {
        let away = point_world - self.origin_world;
        [
            self.forward_world.dot(&away),
            self.forward_world.perp(&away),
            z_m,
        ]
    }

    /// A corner of another body, in the ego's frame.
    fn corner(&self, model: &Model, [x_m, y_m, z_m]: [f64; 3]) -> [f64; 3] {
        let ahead = model.forward_world;
        let left = Vector::new(-ahead.y, ahead.x);
        self.body(model.center_world + ahead * x_m + left * y_m, z_m)
    }

    /// Squared distance to a point in the ego's frame, m2; from above all points are
    /// equally far.
    fn away_m2(&self, point_body: [f64; 3]) -> f64 {
        match self.camera.orthographic {
            0 => {
                let from = self.camera.position_body_m;
                (0..3).map(|k| (point_body[k] - from[k]).powi(2)).sum()
            }
            _ => 0.0,
        }
    }

    /// Whether the camera sees the side on which the corners run counter-clockwise.
    fn sees(&self, corners_body: &[[f64; 3]]) -> bool {
        let [a, b, c] = [0, 1, 2].map(|k| corners_body[k * (corners_body.len() - 1) / 2]);
        let minus = |p: [f64; 3], q: [f64; 3]| [0, 1, 2].map(|k| p[k] - q[k]);
        let (ab, ac) = (minus(b, a), minus(c, a));
        let normal = [
            ab[1] * ac[2] - ab[2] * ac[1],
            ab[2] * ac[0] - ab[0] * ac[2],
            ab[0] * ac[1] - ab[1] * ac[0],
        ];
        let towards = match self.camera.orthographic {
            0 => minus(self.camera.position_body_m, a),
            _ => [0.0, 0.0, 1.0],
        };
        (0..3).map(|k| normal[k] * towards[k]).sum::<f64>() > 1e-9
    }

    /// Pixels per metre at a point in the ego's frame.
    fn px_per_m(&self, point_body: [f64; 3]) -> f64 {
        let row = &self.camera.pixel_from_body[..3];
        let focal = row.iter().map(|value| value * value).sum::<f64>().sqrt();
        focal / self.camera.depth(point_body).max(self.camera.near_m)
    }
}

impl Renderer {
    /// Prepares the map of an episode that begins.
    pub fn begin(&mut self, world: &World) {
        self.layers = survey(world);
    }

    /// Draws the world as it stands, in the episode that was begun. `None` when
    /// the picture would have no pixels, or more than memory holds.
    pub fn draw(&mut self, world: &World, shot: &Shot) -> Option<Picture<'_>> {
        if self.canvas.as_ref().map(Canvas::size_px) != Some(shot.size_px) {
            self.canvas = Some(Canvas::new(shot.size_px)?);
        }
        let canvas = self.canvas.as_mut()?;
        let eye = Eye::new(world, shot);
        canvas.clear(palette::GROUND);
        draw_ground(canvas, &eye, &self.layers, &mut self.outlines);
        draw_sky(canvas, &eye);
        draw_bodies(canvas, &eye, world);
        Some(Picture {
            camera: eye.camera,
            size_px: shot.size_px,
            rgb: canvas.rgb(),
        })
    }
}

fn draw_ground(canvas: &mut Canvas, eye: &Eye, layers: &[Layer], outlines: &mut Vec<Outline>) {
    let mut corners_body = Vec::new();
    for layer in layers {
        let mut count = 0;
        for area in &layer.areas {
            if (area.middle_world - eye.origin_world).norm() > REACH_M + area.radius_m {
                continue;
            }
            corners_body.clear();
            corners_body.extend(
                area.corners_world
                    .iter()
                    .map(|&corner| eye.body(corner, 0.0)),
            );
            if outlines.len() == count {
                outlines.push(Outline::new());
            }
            eye.camera.project_area(&corners_body, &mut outlines[count]);
            count += usize::from(!outlines[count].is_empty());
        }
        canvas.fill(&outlines[..count], layer.color, 1.0);
    }
}

/// Fills the area above the horizon; from above there is none.
fn draw_sky(canvas: &mut Canvas, eye: &Eye) {
    if eye.camera.orthographic != 0 {
        return;
    }
    // The horizon is where parallels meet straight ahead, because the ground is level.
    let matrix = &eye.camera.pixel_from_body;
    let horizon_px = matrix[4] / matrix[8];
    let [width_px, _] = canvas.size_px().map(f64::from);
    let sky = vec![
        [-width_px, -1.0],
        [2.0 * width_px, -1.0],
        [2.0 * width_px, horizon_px],
        [-width_px, horizon_px],
    ];
    canvas.fill([&sky], palette::SKY, 1.0);
}

fn draw_bodies(canvas: &mut Canvas, eye: &Eye, world: &World) {
    let mut models: Vec<(f64, Model)> = world
        .bodies()
        .filter(|body| (body.placed.center_world - eye.origin_world).norm() < REACH_M)
        .map(|body| {
            (
                eye.away_m2(eye.body(body.placed.center_world, 0.0)),
                solids::of(&body),
            )
        })
        .collect();
    models.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    if eye.camera.view == View::TopDown.code() {
        let height_m = world.ego_car().model.height_m;
        let seen = Placed {
            center_world: eye.origin_world,
            forward_world: eye.forward_world,
            ..world.ego_seen()
        };
        models.push((0.0, solids::ego(&seen, height_m)));
    }
    // Shadows lie on the ground, under every body.
    let mut corners_body = Vec::new();
    let mut outline = Outline::new();
    for (_, model) in &models {
        let corners = model
            .footprint
            .iter()
            .map(|&corner| eye.corner(model, corner));
        corners_body.clear();
        corners_body.extend(corners);
        eye.camera.project_area(&corners_body, &mut outline);
        canvas.fill([&outline], palette::RIM, SHADOW);
    }
    for (_, model) in &mut models {
        thicken(eye, model);
        draw_model(canvas, eye, model);
    }
}

/// From above, bodies that are too thin to be seen are drawn thicker.
fn thicken(eye: &Eye, model: &mut Model) {
    if eye.camera.orthographic == 0 {
        return;
    }
    let px_per_m = eye.px_per_m([0.0; 3]);
    let times = [0, 1].map(|axis| {
        let reaches_m = model.footprint.iter().map(|corner| corner[axis].abs());
        let across_px = 2.0 * reaches_m.fold(0.0, f64::max) * px_per_m;
        (LEAST_PX / across_px).max(1.0)
    });
    let faces = model.solids.iter_mut().flat_map(|solid| &mut solid.faces);
    for corner in faces.flat_map(|face| &mut face.corners) {
        corner[0] *= times[0];
        corner[1] *= times[1];
    }
}

fn draw_model(canvas: &mut Canvas, eye: &Eye, model: &Model) {
    let mut solids: Vec<(f64, Solid)> = model
        .solids
        .iter()
        .map(|solid| {
            let faces = solid.faces.iter().map(|face| placed(eye, model, face));
            let solid = Solid {
                faces: faces.collect(),
                ..*solid
            };
            (eye.away_m2(middle(&solid.faces)), solid)
        })
        .collect();
    solids.sort_by(|(a_m2, a), (b_m2, b)| a.level.cmp(&b.level).then(b_m2.total_cmp(a_m2)));
    let mut outline = Outline::new();
    for (_, solid) in &solids {
        for face in solid.faces.iter().filter(|face| eye.sees(&face.corners)) {
            eye.camera.project_area(&face.corners, &mut outline);
            canvas.fill([&outline], face.color, 1.0);
            if solid.rim == Rim::Drawn {
                let rim_px = (RIM_M * eye.px_per_m(face.corners[0])).min(RIM_MAX_PX);
                canvas.rim(&outline, palette::RIM, rim_px);
            }
        }
    }
}

/// A face of a body, in the ego's frame.
fn placed(eye: &Eye, model: &Model, face: &Face) -> Face {
    let corners = face.corners.iter().map(|&corner| eye.corner(model, corner));
    Face {
        corners: corners.collect(),
        color: face.color,
    }
}

fn middle(faces: &[Face]) -> [f64; 3] {
    let corners = || faces.iter().flat_map(|face| &face.corners);
    let count = corners().count().max(1) as f64;
    [0, 1, 2].map(|axis| corners().map(|corner| corner[axis]).sum::<f64>() / count)
}
