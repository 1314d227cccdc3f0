//! Bodies as a few convex solids. Their ground area is that of contacts; their heights
//! are those of the simulator's models.

use shm_config::palette::{self, Rgb};
use vehicle::{Footprint, Point, Vector};

use crate::contact::{Placed, Shape};
use crate::model::VehicleKind;
use crate::spawn::ObstacleKind;
use crate::world::{Body, BodyKind};

/// Heights of obstacles, m.
const CONE_M: f64 = 0.9;
const WARNING_M: f64 = 1.1;
const BARRIER_M: f64 = 1.1;
/// Thickness of flat objects on the ground, m.
const PLATE_M: f64 = 0.08;
/// Clearance under a car, m.
const FLOOR_M: f64 = 0.25;
/// Brightness of the sides of a solid; its top has full brightness.
const SIDE_LIGHT: f64 = 0.88;
const END_LIGHT: f64 = 0.8;

/// A polygon in the frame of its body: x forward, y left, z up from the ground.
pub struct Face {
    /// Its corners, m, counter-clockwise seen from outside.
    pub corners: Vec<[f64; 3]>,
    /// Its colour.
    pub color: Rgb,
}

/// Whether the rims of a solid's faces are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rim {
    /// They are: it tells a body from what is behind it.
    Drawn,
    /// They would cover the small faces of a round body.
    Left,
}

/// A convex solid.
pub struct Solid {
    /// Solids of a body are drawn level by level.
    pub level: u32,
    /// Whether its faces have rims.
    pub rim: Rim,
    /// Its faces.
    pub faces: Vec<Face>,
}

/// A body to be drawn.
pub struct Model {
    /// Its origin.
    pub center_world: Point,
    /// Its x axis.
    pub forward_world: Vector,
    /// Corners of its ground area in its own frame, m, for the shadow.
    pub footprint: Vec<[f64; 3]>,
    /// Its solids.
    pub solids: Vec<Solid>,
}

/// Colours of a solid: its sides, and its top.
#[derive(Clone, Copy)]
struct Coat {
    sides: Rgb,
    top: Rgb,
}

impl Coat {
    const fn plain(color: Rgb) -> Coat {
        Coat {
            sides: color,
            top: color,
        }
    }
}

/// Colours of a car: its body, and its windows.
#[derive(Clone, Copy)]
struct Livery {
    body: Rgb,
    glass: Rgb,
}

/// The car itself, seen from above.
pub fn ego(placed: &Placed, height_m: f64) -> Model {
    let livery = Livery {
        body: palette::EGO,
        glass: palette::RIM,
    };
    model(placed, car(&placed.shape, height_m, livery))
}

/// Any other body.
pub fn of(body: &Body) -> Model {
    let shape = &body.placed.shape;
    let livery = Livery {
        body: palette::VEHICLE,
        glass: palette::VEHICLE_GLASS,
    };
    let vehicle = |kind: VehicleKind| {
        let height_m = kind.model().height_m;
        match kind {
            VehicleKind::ExtraLarge => truck(shape, height_m, livery),
            _ => car(shape, height_m, livery),
        }
    };
    let solids = match body.kind {
        BodyKind::Traffic(kind) | BodyKind::Obstacle(ObstacleKind::BrokenDown(kind)) => {
            vehicle(kind)
        }
        BodyKind::Obstacle(ObstacleKind::Cone) => cone(shape.radius_m()),
        BodyKind::Obstacle(ObstacleKind::Warning) => warning(shape.radius_m()),
        BodyKind::Obstacle(ObstacleKind::Barrier) => barrier(shape),
    };
    model(&body.placed, solids)
}

fn model(placed: &Placed, solids: Vec<Solid>) -> Model {
    let ring = match placed.shape {
        Shape::Box(Footprint { length_m, width_m }) => {
            let half_m = width_m / 2.0;
            quad([-length_m / 2.0, length_m / 2.0], [half_m, half_m])
        }
        Shape::Disc { radius_m } => disc(radius_m),
    };
    Model {
        center_world: placed.center_world,
        forward_world: placed.forward_world,
        footprint: ring.into_iter().map(|[x, y]| [x, y, 0.0]).collect(),
        solids,
    }
}

fn half_sides(shape: &Shape) -> [f64; 2] {
    match *shape {
        Shape::Box(Footprint { length_m, width_m }) => [length_m / 2.0, width_m / 2.0],
        Shape::Disc { radius_m } => [radius_m; 2],
    }
}

/// A trapezoid from x to x, with half widths at both, counter-clockwise from its
/// left rear corner.
fn quad([rear, front]: [f64; 2], [half_rear, half_front]: [f64; 2]) -> Vec<[f64; 2]> {
    vec![
        [rear, half_rear],
        [rear, -half_rear],
        [front, -half_front],
        [front, half_front],
    ]
}

fn disc(radius_m: f64) -> Vec<[f64; 2]> {
    const CORNERS: usize = 12;
    let corner = |k: usize| {
        let (sin, cos) = (k as f64 * std::f64::consts::TAU / CORNERS as f64).sin_cos();
        [radius_m * cos, radius_m * sin]
    };
    (0..CORNERS).map(corner).collect()
}

/// The solid between two polygons with equally many corners, the lower and the upper
/// one.
fn solid(level: u32, rings: [&[[f64; 2]]; 2], [low_m, high_m]: [f64; 2], coat: Coat) -> Solid {
    let [low, high] = rings;
    let count = low.len().min(high.len());
    let mut faces = Vec::with_capacity(count + 1);
    for k in 0..count {
        let next = (k + 1) % count;
        let at = |ring: &[[f64; 2]], k: usize, z_m: f64| [ring[k][0], ring[k][1], z_m];
        // A side that runs across the body faces its front or back.
        let [along, across] = [0, 1].map(|axis| (low[next][axis] - low[k][axis]).abs());
        let light = if across > along {
            END_LIGHT
        } else {
            SIDE_LIGHT
        };
        faces.push(Face {
            corners: vec![
                at(low, k, low_m),
                at(low, next, low_m),
                at(high, next, high_m),
                at(high, k, high_m),
            ],
            color: palette::shaded(coat.sides, light),
        });
    }
    let top = high[..count].iter().map(|&[x, y]| [x, y, high_m]);
    faces.push(Face {
        corners: top.collect(),
        color: coat.top,
    });
    let rim = match count {
        0..=4 => Rim::Drawn,
        _ => Rim::Left,
    };
    Solid { level, rim, faces }
}

/// Wheels and shadow under a car.
fn chassis(half_x_m: f64, half_y_m: f64) -> Solid {
    let ring = quad([-half_x_m, half_x_m], [half_y_m, half_y_m]);
    solid(0, [&ring, &ring], [0.0, FLOOR_M], Coat::plain(palette::RIM))
}

fn car(shape: &Shape, height_m: f64, livery: Livery) -> Vec<Solid> {
    let [half_x_m, half_y_m] = half_sides(shape);
    let waist_m = FLOOR_M + (height_m - FLOOR_M) * 0.5;
    let body = quad([-half_x_m, half_x_m], [half_y_m, half_y_m]);
    let sill = quad(
        [-0.88 * half_x_m, 0.42 * half_x_m],
        [0.9 * half_y_m, 0.9 * half_y_m],
    );
    let roof = quad(
        [-0.62 * half_x_m, 0.06 * half_x_m],
        [0.74 * half_y_m, 0.74 * half_y_m],
    );
    let cabin = Coat {
        sides: livery.glass,
        top: livery.body,
    };
    vec![
        chassis(half_x_m, half_y_m),
        solid(
            1,
            [&body, &body],
            [FLOOR_M, waist_m],
            Coat::plain(livery.body),
        ),
        solid(2, [&sill, &roof], [waist_m, height_m], cabin),
    ]
}

/// A cab, and a box behind it.
fn truck(shape: &Shape, height_m: f64, livery: Livery) -> Vec<Solid> {
    let [half_x_m, half_y_m] = half_sides(shape);
    let (deck_m, hood_m) = (0.75, height_m * 0.5);
    let plain = Coat::plain(livery.body);
    let bed = quad([-half_x_m, half_x_m], [half_y_m, half_y_m]);
    let cargo = quad([-half_x_m, 0.4 * half_x_m], [half_y_m, half_y_m]);
    let sill = quad([0.46 * half_x_m, half_x_m], [half_y_m, half_y_m]);
    let roof = quad(
        [0.46 * half_x_m, 0.8 * half_x_m],
        [0.85 * half_y_m, 0.85 * half_y_m],
    );
    let glass = Coat {
        sides: livery.glass,
        top: livery.body,
    };
    // The windows belong to the cab: from behind, the box hides both.
    let mut cab = solid(2, [&sill, &sill], [deck_m, hood_m], plain);
    let windows = solid(2, [&sill, &roof], [hood_m, height_m * 0.85], glass);
    cab.faces.extend(windows.faces);
    vec![
        chassis(half_x_m, half_y_m),
        solid(1, [&bed, &bed], [FLOOR_M, deck_m], plain),
        solid(2, [&cargo, &cargo], [deck_m, height_m], plain),
        cab,
    ]
}

/// A foot, and a cone with a white band on it.
fn cone(radius_m: f64) -> Vec<Solid> {
    let ring = |share: f64| disc(radius_m * share);
    let rings = [1.0, 0.85, 0.55, 0.35, 0.1].map(ring);
    let heights_m = [0.0, PLATE_M, 0.45 * CONE_M, 0.7 * CONE_M, CONE_M];
    let coats = [
        palette::OBJECT,
        palette::OBJECT,
        palette::LINE_SOLID,
        palette::OBJECT,
    ];
    let part = |k: usize| {
        let coat = Coat {
            sides: coats[k],
            top: palette::OBJECT,
        };
        solid(
            k as u32,
            [&rings[k], &rings[k + 1]],
            [heights_m[k], heights_m[k + 1]],
            coat,
        )
    };
    (0..coats.len()).map(part).collect()
}

/// A triangle across the lane on a flat foot.
fn warning(radius_m: f64) -> Vec<Solid> {
    let coat = Coat::plain(palette::OBJECT);
    let foot = disc(radius_m);
    let board = |half_m: f64| quad([-0.05, 0.05], [half_m, half_m]);
    vec![
        solid(0, [&foot, &foot], [0.0, PLATE_M], coat),
        solid(
            1,
            [&board(radius_m), &board(0.03)],
            [PLATE_M, WARNING_M],
            coat,
        ),
    ]
}

/// Boards side by side, every second one white.
fn barrier(shape: &Shape) -> Vec<Solid> {
    const BOARDS: usize = 5;
    let [half_x_m, half_y_m] = half_sides(shape);
    let width_m = 2.0 * half_y_m / BOARDS as f64;
    let board = |k: usize| {
        let left_m = half_y_m - k as f64 * width_m;
        let right_m = left_m - width_m;
        let ring = [
            [-half_x_m, left_m],
            [-half_x_m, right_m],
            [half_x_m, right_m],
            [half_x_m, left_m],
        ];
        let coat = Coat {
            sides: [palette::OBJECT, palette::LINE_SOLID][k % 2],
            top: palette::OBJECT,
        };
        solid(0, [&ring, &ring], [0.0, BARRIER_M], coat)
    };
    (0..BOARDS).map(board).collect()
}
