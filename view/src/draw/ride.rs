//! Draws what moved: the ego's path by driver, traffic, contacts, and the last scan.

use shm_config::message::{Driver, Observation};
use sim::World;
use sim::spawn::ObstacleKind;
use sim::world::{Body, BodyKind};
use vehicle::{Point, Vector, pose};

use super::canvas::{Canvas, Stroke};
use super::labels::Labels;
use super::palette;
use super::tracks::Tracks;
use stack::episode::Tick;

/// Ticks between two dots on the ego's path: 5 s.
const MARK_TICKS: usize = 50;
/// Dots per time label.
const LABEL_MARKS: usize = 2;

/// Contacts closer than this are drawn as one, m.
const CONTACTS_APART_M: f64 = 8.0;

/// Radius of the ring around a contact, m.
const RING_M: f64 = 3.4;
/// Directions from a contact to its label, in the order of preference.
const LABEL_DIRECTIONS: [[f64; 2]; 8] = [
    [0.0, 1.0],
    [0.0, -1.0],
    [1.0, 0.0],
    [-1.0, 0.0],
    [1.0, 1.0],
    [-1.0, 1.0],
    [1.0, -1.0],
    [-1.0, -1.0],
];

/// Minimum size of a cone or a triangle, m.
const MARK_M: f64 = 1.1;
/// Possible distances of time labels from the path, m.
const TIMES_BESIDE_M: [f64; 8] = [3.2, -3.2, 4.6, -4.6, 6.2, -6.2, 8.0, -8.0];

/// The body that was touched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum With {
    /// A car.
    Vehicle,
    /// A cone, a triangle or a barrier.
    Object,
    /// A sidewalk, which ends the episode.
    Sidewalk,
}

/// The record of an episode.
pub struct Ride {
    /// The ego's positions; one more than drivers.
    positions_world: Vec<Point>,
    /// The driver between consecutive positions.
    drivers: Vec<Driver>,
    /// Position and body of each contact at its begin.
    contacts: Vec<(Point, With)>,
    touching: [bool; 3],
    tracks: Tracks,
}

impl Ride {
    /// Starts recording at the begin of an episode.
    pub fn begin(world: &World) -> Ride {
        let mut tracks = Tracks::default();
        tracks.follow(world.bodies());
        Ride {
            positions_world: vec![world.ego_position()],
            drivers: Vec::new(),
            contacts: Vec::new(),
            touching: [false; 3],
            tracks,
        }
    }

    /// Records a tick.
    pub fn watch(&mut self, tick: &Tick) {
        let at = tick.world.ego_position();
        self.positions_world.push(at);
        self.drivers.push(tick.command.driver());
        let touch = tick.outcome.touch;
        let now = [touch.vehicle, touch.object, tick.outcome.on_sidewalk];
        let kinds = [With::Vehicle, With::Object, With::Sidewalk];
        for ((now, before), with) in now.into_iter().zip(self.touching).zip(kinds) {
            let is_known = |&(known, kind): &(Point, With)| {
                kind == with && (at - known).norm() < CONTACTS_APART_M
            };
            if now && !before && !self.contacts.iter().any(is_known) {
                self.contacts.push((at, with));
            }
        }
        self.touching = now;
        self.tracks.follow(tick.world.bodies());
    }

    /// The drivers that drove, with their number of ticks.
    pub fn drivers(&self) -> impl Iterator<Item = (Driver, usize)> {
        [Driver::Expert, Driver::Policy, Driver::Brake]
            .into_iter()
            .map(|driver| {
                (
                    driver,
                    self.drivers.iter().filter(|d| **d == driver).count(),
                )
            })
            .filter(|(_, ticks)| *ticks > 0)
    }

    /// Whether anything was touched.
    pub fn has_contacts(&self) -> bool {
        !self.contacts.is_empty()
    }

    /// Whether a car of the traffic has moved.
    pub fn has_traffic(&self) -> bool {
        self.tracks.all().iter().any(|track| track.has_moved())
    }

    /// Reserves paths, contacts and bodies, so that labels keep clear of them and of each
    /// other.
    pub fn labels(&self, canvas: &Canvas, world: &World) -> Labels {
        let contacts = self.contacts.iter().map(|&(at, _)| (at, RING_M));
        let bodies = world.bodies().map(|body| {
            let center = body.placed.center_world;
            let corners = body.placed.corners_world().into_iter();
            let reach_m = corners.map(|corner| (corner - center).norm());
            (center, reach_m.fold(MARK_M, f64::max))
        });
        let spots: Vec<(Point, f64)> = contacts.chain(bodies).collect();
        let moved = self.tracks.all().iter().filter(|track| track.has_moved());
        let mut paths = self.positions_world.clone();
        paths.extend(moved.flat_map(|track| &track.positions_world));
        Labels::beside(canvas, &paths, &spots)
    }

    /// Draws the ego's path, one colour per driver, with a dot every five seconds.
    pub fn draw_path(&self, canvas: &mut Canvas, labels: &mut Labels) {
        canvas.line(&self.positions_world, Stroke::solid(palette::INK, 1.5));
        let mut begin = 0;
        for run in self.drivers.chunk_by(|a, b| a == b) {
            let end = begin + run.len();
            let color = palette::driver(run[0]);
            let points = &self.positions_world[begin..=end];
            canvas.line(points, Stroke::solid(color, 0.95));
            begin = end;
        }
        let marks = self.positions_world.iter().enumerate().step_by(MARK_TICKS);
        let mut last: Option<Point> = None;
        for (count, (tick, &at)) in marks.enumerate().skip(1) {
            // A standing car would draw its dots on top of each other.
            if last.is_some_and(|last| (at - last).norm() < 3.0) {
                continue;
            }
            last = Some(at);
            canvas.disc(at, 0.75, palette::INK);
            canvas.disc(at, 0.4, palette::EGO);
            if count % LABEL_MARKS == 0 {
                let size_px = (2.3 * canvas.scale_px_per_m()).max(9.0);
                let left = self.left_of(tick);
                let text = format!("{} s", tick / 10);
                let places = TIMES_BESIDE_M.map(|beside_m| at + left * beside_m);
                if let Some(place) = labels.take(canvas, &places, (&text, size_px)) {
                    let colors = (palette::WHITE_LINE, palette::INK);
                    canvas.rimmed_label(place, &text, (colors, size_px));
                }
            }
        }
    }

    /// The unit vector to the left of the path at a tick.
    fn left_of(&self, tick: usize) -> Vector {
        let before = self.positions_world[tick.saturating_sub(1)];
        let along = self.positions_world[tick] - before;
        let left = Vector::new(-along.y, along.x);
        left.try_normalize(1e-6).unwrap_or(Vector::y())
    }

    /// Draws the paths of the other cars, fainter towards their begin.
    pub fn draw_traffic(&self, canvas: &mut Canvas) {
        for track in self.tracks.all().iter().filter(|track| track.has_moved()) {
            let stroke = Stroke {
                opacity: 0.55,
                ..Stroke::solid(palette::TRAFFIC, 0.45)
            };
            canvas.line(&track.positions_world, stroke);
            if let Some(&first) = track.positions_world.first() {
                canvas.ring(first, 0.8, Stroke::solid(palette::TRAFFIC, 0.3));
            }
        }
    }

    /// Draws where contacts began.
    pub fn draw_contacts(&self, canvas: &mut Canvas, labels: &mut Labels) {
        let size_px = (2.6 * canvas.scale_px_per_m()).max(10.0);
        for &(at, _) in &self.contacts {
            canvas.ring(at, RING_M, Stroke::solid(palette::PAPER, 1.3));
            canvas.ring(at, RING_M, Stroke::solid(palette::CONTACT, 0.8));
        }
        for &(at, with) in &self.contacts {
            let word = match with {
                With::Vehicle => "vehicle",
                With::Object => "object",
                With::Sidewalk => "sidewalk",
            };
            // Above and below first, where the text is closest to its ring.
            let places = LABEL_DIRECTIONS.map(|[x, y]| {
                let wide_m = 0.3 * word.len() as f64 * size_px / canvas.scale_px_per_m();
                at + Vector::new(x * (4.2 + wide_m), y * 5.6)
            });
            if let Some(place) = labels.take(canvas, &places, (word, size_px)) {
                let colors = (palette::CONTACT, palette::PAPER);
                canvas.rimmed_label(place, word, (colors, size_px));
            }
        }
    }
}

/// Draws the lidar returns of an observation.
pub fn draw_scan(canvas: &mut Canvas, seen: &Observation) {
    let ego = &seen.ego;
    let world_from_body = pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
    let fan = seen.fan();
    let mut ends: Vec<(Point, bool)> = seen
        .ranges()
        .iter()
        .enumerate()
        .map(|(k, &range_m)| {
            let end_body = fan.point_body(k, f64::from(range_m));
            (world_from_body * end_body, range_m < seen.lidar_max_m)
        })
        .collect();
    let origin = world_from_body * fan.mount_body;
    if !fan.is_circle() {
        // The area of a partial scan is closed by where its beams begin.
        ends.push((origin, false));
    }
    let corners: Vec<Point> = ends.iter().map(|&(end, _)| end).collect();
    canvas.area(&corners, palette::SCAN, 0.16);
    for (end, _) in ends.into_iter().filter(|&(_, hit)| hit) {
        let beam = Stroke {
            opacity: 0.7,
            ..Stroke::solid(palette::SCAN, 0.1)
        };
        canvas.line(&[origin, end], beam);
        canvas.disc(end, 0.4, palette::SCAN);
    }
}

/// Draws all bodies but the ego at their present positions.
pub fn draw_bodies(canvas: &mut Canvas, world: &World) {
    for body in world.bodies() {
        match body.kind {
            BodyKind::Traffic(_) => draw_car(canvas, &body, palette::TRAFFIC),
            BodyKind::Obstacle(ObstacleKind::BrokenDown(_)) => {
                draw_car(canvas, &body, palette::BROKEN_DOWN);
            }
            BodyKind::Obstacle(ObstacleKind::Barrier) => {
                canvas.body(&body.placed.corners_world(), palette::CONE, palette::EGO);
            }
            BodyKind::Obstacle(ObstacleKind::Cone) => {
                canvas.disc(body.placed.center_world, 0.5, palette::EGO);
                canvas.disc(body.placed.center_world, 0.36, palette::CONE);
            }
            BodyKind::Obstacle(ObstacleKind::Warning) => draw_warning(canvas, &body),
        }
    }
}

fn draw_car(canvas: &mut Canvas, body: &Body, color: &str) {
    draw_box(canvas, body.placed.corners_world(), (color, palette::INK));
}

/// Draws a car with its windscreen, which marks the front.
pub fn draw_box(canvas: &mut Canvas, corners: [Point; 4], (color, rim): (&str, &str)) {
    canvas.body(&corners, color, rim);
    let [front_left, rear_left, rear_right, front_right] = corners;
    let between = |a: Point, b: Point, share: f64| a + (b - a) * share;
    let (left, right) = (
        |share| between(front_left, rear_left, share),
        |share| between(front_right, rear_right, share),
    );
    let screen = [
        between(left(0.24), right(0.24), 0.12),
        between(left(0.24), right(0.24), 0.88),
        between(left(0.4), right(0.4), 0.82),
        between(left(0.4), right(0.4), 0.18),
    ];
    canvas.area(&screen, palette::INK, 0.75);
}

fn draw_warning(canvas: &mut Canvas, body: &Body) {
    let center = body.placed.center_world;
    let ahead = body.placed.forward_world;
    let left = Vector::new(-ahead.y, ahead.x);
    let corners = [
        center + ahead * 1.1,
        center - ahead * 0.55 + left * 0.95,
        center - ahead * 0.55 - left * 0.95,
    ];
    canvas.body(&corners, palette::WARNING, palette::CONTACT);
}

/// Draws the ego at its present position.
pub fn draw_ego(canvas: &mut Canvas, world: &World) {
    let corners = world.ego_seen().corners_world();
    draw_box(canvas, corners, (palette::EGO, palette::INK));
}
