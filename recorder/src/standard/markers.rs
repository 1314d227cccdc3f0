//! The scene as markers: `visualization_msgs/MarkerArray`.

use shm_config::palette::{self, Rgb};
use vehicle::Point;

use super::cdr::Cdr;
use super::messages::{self, Frame, TimeStamp};

/// Height of the drawn car, m.
const CAR_HEIGHT_M: f64 = 1.5;
/// Pieces of the circle around a body.
const CIRCLE_PIECES: u32 = 16;

/// A kind of marker, by its code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Box = 1,
    LineStrip = 4,
    LineList = 5,
    SphereList = 7,
    Text = 9,
}

/// One marker; `add` or `delete` follows from its content.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Marker {
    /// What it belongs to; a viewer shows and hides markers by this.
    pub(super) group: &'static str,
    pub(super) id: i32,
    pub(super) kind: Kind,
    pub(super) at: [f64; 3],
    pub(super) scale_m: [f64; 3],
    pub(super) color: Rgb,
    pub(super) opacity: f32,
    pub(super) points: Vec<Point>,
    pub(super) text: String,
}

impl Marker {
    /// Lines or spheres of this width, m.
    pub(super) fn of_points(
        (group, id, kind): (&'static str, i32, Kind),
        (color, opacity): (Rgb, f32),
        width_m: f64,
        points: Vec<Point>,
    ) -> Self {
        let scale_m = match kind {
            Kind::SphereList => [width_m; 3],
            _ => [width_m, 0.0, 0.0],
        };
        Self {
            group,
            id,
            kind,
            at: [0.0; 3],
            scale_m,
            color,
            opacity,
            points,
            text: String::new(),
        }
    }

    /// The car itself.
    pub(super) fn car(length_m: f64, width_m: f64, color: Rgb) -> Self {
        Self {
            group: "car",
            id: 0,
            kind: Kind::Box,
            at: [0.0, 0.0, CAR_HEIGHT_M / 2.0],
            scale_m: [length_m, width_m, CAR_HEIGHT_M],
            color,
            opacity: 0.8,
            points: Vec::new(),
            text: String::new(),
        }
    }

    /// A line of text above the car.
    pub(super) fn label(text: String, color: Rgb) -> Self {
        Self {
            group: "driver",
            id: 0,
            kind: Kind::Text,
            at: [0.0, 0.0, 2.0 * CAR_HEIGHT_M],
            scale_m: [0.0, 0.0, 1.0],
            color,
            opacity: 1.0,
            points: Vec::new(),
            text,
        }
    }

    /// Whether there is nothing to draw, so that an earlier one is removed.
    fn is_empty(&self) -> bool {
        match self.kind {
            Kind::Box => false,
            Kind::Text => self.text.is_empty(),
            Kind::LineStrip | Kind::LineList => self.points.len() < 2,
            Kind::SphereList => self.points.is_empty(),
        }
    }

    fn write(&self, cdr: &mut Cdr, time: TimeStamp) {
        const ADD: i32 = 0;
        const DELETE: i32 = 2;
        messages::header(cdr, time, Frame::Body);
        cdr.text(self.group).i32(self.id).i32(self.kind as i32);
        cdr.i32(if self.is_empty() { DELETE } else { ADD });
        cdr.f64s(self.at).f64s(messages::rotation(0.0));
        cdr.f64s(self.scale_m);
        cdr.f32s(self.color.map(|part| f32::from(part) / 255.0));
        // Without a lifetime, and left where it was when the frame moves on.
        cdr.f32(self.opacity).i32(0).u32(0).u8(0);
        cdr.count(self.points.len());
        for point in &self.points {
            cdr.f64s([point.x, point.y, 0.0]);
        }
        // One colour for all points, and no texture: a header, a format and no data.
        cdr.count(0).text("").i32(0).u32(0).text("").text("");
        cdr.count(0).count(0).text(&self.text);
        // No mesh: resource, file and its data.
        cdr.text("").text("").count(0).u8(0);
    }
}

/// All markers of a moment.
pub(super) fn write(cdr: &mut Cdr, time: TimeStamp, markers: &[Marker]) {
    cdr.begin().count(markers.len());
    for marker in markers {
        marker.write(cdr, time);
    }
}

/// The points of a circle as a list of lines.
pub(super) fn circle(at: Point, radius_m: f64) -> impl Iterator<Item = Point> {
    let on_it = move |piece: u32| {
        let angle_rad = f64::from(piece) / f64::from(CIRCLE_PIECES) * std::f64::consts::TAU;
        Point::new(
            at.x + radius_m * angle_rad.cos(),
            at.y + radius_m * angle_rad.sin(),
        )
    };
    (0..CIRCLE_PIECES).flat_map(move |piece| [on_it(piece), on_it(piece + 1)])
}

/// A path as a list of lines.
pub(super) fn lines(path: &[Point]) -> impl Iterator<Item = Point> {
    path.windows(2).flat_map(|pair| [pair[0], pair[1]])
}

/// The colour of what is vetoed.
pub(super) const VETOED: Rgb = palette::driver(shm_config::message::Driver::Brake);
