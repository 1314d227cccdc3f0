//! A picture drawn in world coordinates, in metres: as SVG, or as pixels.

use std::fmt::Write as _;

use sim::Bounds;
use sim::road::Network;
use svg::node::element::{Circle, ClipPath, Definitions, Element, Group, Path, Rectangle, Text};
use svg::{Document, Node};
use vehicle::{Point, Vector};

use super::palette;
use super::raster::{Align, Pen, Raster};

/// Margin around the roads, m.
const MARGIN_M: f64 = 9.0;
/// Maximum size of the map, px.
const WIDTH_PX: f64 = 1500.0;
const HEIGHT_PX: f64 = 1050.0;
/// Maximum scale of small maps.
const SCALE_MAX_PX_PER_M: f64 = 9.0;
/// Minimum width of a picture, which the legend needs, px.
const WIDTH_MIN_PX: f64 = 900.0;
/// Height of the title above the map, px.
pub const HEAD_PX: f64 = 84.0;

/// Style of a line. Widths are metres on the ground.
#[derive(Clone, Copy)]
pub struct Stroke<'a> {
    /// Colour.
    pub color: &'a str,
    /// Width, m.
    pub width_m: f64,
    /// Opacity, (0, 1].
    pub opacity: f64,
    /// Lengths of dash and gap, m.
    pub dash_m: Option<[f64; 2]>,
}

impl<'a> Stroke<'a> {
    /// A solid, opaque line.
    pub fn solid(color: &'a str, width_m: f64) -> Stroke<'a> {
        Stroke {
            color,
            width_m,
            opacity: 1.0,
            dash_m: None,
        }
    }
}

/// A picture that is being drawn.
pub struct Canvas {
    min_world: Point,
    max_world: Point,
    scale_px_per_m: f64,
    size_px: [f64; 2],
    /// Height of the title above the map, px.
    head_px: f64,
    sheet: Sheet,
}

/// What a picture is drawn on.
enum Sheet {
    Svg(Group),
    Pixels(Raster),
}

impl Canvas {
    /// An empty picture that covers these roads.
    pub fn around(network: &Network) -> Canvas {
        let mut bounds = Bounds::EMPTY;
        for lane in network.bounds() {
            bounds.include(lane.min_world);
            bounds.include(lane.max_world);
        }
        let margin = Vector::new(MARGIN_M, MARGIN_M);
        let (min_world, max_world) = (bounds.min_world - margin, bounds.max_world + margin);
        let size_m = max_world - min_world;
        let scale_px_per_m = (WIDTH_PX / size_m.x)
            .min(HEIGHT_PX / size_m.y)
            .min(SCALE_MAX_PX_PER_M);
        let width_px = (size_m.x * scale_px_per_m).max(WIDTH_MIN_PX);
        // If the picture is wider than the map, centre the map.
        let spare = Vector::new((width_px / scale_px_per_m - size_m.x) / 2.0, 0.0);
        Canvas {
            min_world: min_world - spare,
            max_world: max_world + spare,
            scale_px_per_m,
            size_px: [width_px, size_m.y * scale_px_per_m],
            head_px: HEAD_PX,
            sheet: Sheet::Svg(
                Group::new()
                    .set("stroke-linecap", "butt")
                    .set("stroke-linejoin", "round"),
            ),
        }
    }

    /// A picture in pixels that shows this many metres from left to right; `None` when it has
    /// no pixels, or more than memory holds.
    pub fn pixels(center_world: Point, across_m: f64, size_px: [u32; 2]) -> Option<Canvas> {
        let [width_px, height_px] = size_px.map(f64::from);
        let scale_px_per_m = width_px / across_m;
        let half_m = Vector::new(across_m, height_px / scale_px_per_m) / 2.0;
        Some(Canvas {
            min_world: center_world - half_m,
            max_world: center_world + half_m,
            scale_px_per_m,
            size_px: [width_px, height_px],
            head_px: 0.0,
            sheet: Sheet::Pixels(Raster::new(size_px, palette::GROUND)?),
        })
    }

    /// The pixels; `None` of an SVG picture.
    pub fn into_raster(self) -> Option<Raster> {
        match self.sheet {
            Sheet::Pixels(raster) => Some(raster),
            Sheet::Svg(_) => None,
        }
    }

    fn places(&self, points_world: &[Point]) -> Vec<[f64; 2]> {
        points_world.iter().map(|point| self.at(*point)).collect()
    }

    fn pen<'a>(&self, stroke: Stroke<'a>) -> Pen<'a> {
        let scale = self.scale_px_per_m;
        Pen {
            color: stroke.color,
            width_px: stroke.width_m * scale,
            opacity: stroke.opacity,
            dash_px: stroke.dash_m.map(|lengths| lengths.map(|m| m * scale)),
        }
    }

    /// Scale, pixels per metre.
    pub fn scale_px_per_m(&self) -> f64 {
        self.scale_px_per_m
    }

    /// Width and height of the map, px.
    pub fn size_px(&self) -> [f64; 2] {
        self.size_px
    }

    /// Position of a point in the picture, px; the world's y axis points up, the picture's down.
    pub fn at(&self, point_world: Point) -> [f64; 2] {
        [
            (point_world.x - self.min_world.x) * self.scale_px_per_m,
            (self.max_world.y - point_world.y) * self.scale_px_per_m + self.head_px,
        ]
    }

    fn path(&self, points_world: &[Point], close: &str) -> Path {
        let mut data = String::new();
        for (index, point) in points_world.iter().enumerate() {
            let [x, y] = self.at(*point);
            let letter = if index == 0 { 'M' } else { 'L' };
            // Writing to a string cannot fail.
            let _ = write!(data, "{letter}{x:.2} {y:.2}");
        }
        data.push_str(close);
        Path::new().set("d", data)
    }

    /// Draws a line through points.
    pub fn line(&mut self, points_world: &[Point], stroke: Stroke) {
        if points_world.len() < 2 {
            return;
        }
        let (places, pen) = (self.places(points_world), self.pen(stroke));
        if let Sheet::Pixels(raster) = &mut self.sheet {
            return raster.line(&places, pen);
        }
        let scale = self.scale_px_per_m;
        let mut path = self
            .path(points_world, "")
            .set("fill", "none")
            .set("stroke", stroke.color)
            .set("stroke-width", px(stroke.width_m * scale));
        if stroke.opacity < 1.0 {
            path = path.set("stroke-opacity", px(stroke.opacity));
        }
        if let Some([dash_m, gap_m]) = stroke.dash_m {
            let dashes = format!("{} {}", px(dash_m * scale), px(gap_m * scale));
            path = path.set("stroke-dasharray", dashes);
        }
        self.add(path);
    }

    /// Draws a filled polygon.
    pub fn area(&mut self, corners_world: &[Point], color: &str, opacity: f64) {
        let places = self.places(corners_world);
        if let Sheet::Pixels(raster) = &mut self.sheet {
            return raster.area(&places, color, opacity);
        }
        let mut path = self.path(corners_world, "Z").set("fill", color);
        if opacity < 1.0 {
            path = path.set("fill-opacity", px(opacity));
        }
        self.add(path);
    }

    /// Draws a filled polygon with a thin outline, for bodies.
    pub fn body(&mut self, corners_world: &[Point], color: &str, rim: &str) {
        let rim_px = (0.16 * self.scale_px_per_m).max(0.7);
        let places = self.places(corners_world);
        if let Sheet::Pixels(raster) = &mut self.sheet {
            raster.area(&places, color, 1.0);
            let pen = Pen {
                color: rim,
                width_px: rim_px,
                opacity: 1.0,
                dash_px: None,
            };
            return raster.outline(&places, pen);
        }
        let path = self
            .path(corners_world, "Z")
            .set("fill", color)
            .set("stroke", rim)
            .set("stroke-width", px(rim_px));
        self.add(path);
    }

    /// Draws a filled circle; radius in m.
    pub fn disc(&mut self, center_world: Point, radius_m: f64, color: &str) {
        let (place, radius_px) = (self.at(center_world), radius_m * self.scale_px_per_m);
        if let Sheet::Pixels(raster) = &mut self.sheet {
            return raster.disc(place, radius_px, color);
        }
        let circle = self.circle(center_world, radius_m).set("fill", color);
        self.add(circle);
    }

    /// Draws a ring; radius and width in m.
    pub fn ring(&mut self, center_world: Point, radius_m: f64, stroke: Stroke) {
        let (place, radius_px) = (self.at(center_world), radius_m * self.scale_px_per_m);
        let pen = self.pen(stroke);
        if let Sheet::Pixels(raster) = &mut self.sheet {
            return raster.ring(place, radius_px, pen);
        }
        let width_px = px(stroke.width_m * self.scale_px_per_m);
        let circle = self
            .circle(center_world, radius_m)
            .set("fill", "none")
            .set("stroke", stroke.color)
            .set("stroke-width", width_px);
        self.add(circle);
    }

    fn circle(&self, center_world: Point, radius_m: f64) -> Circle {
        let [x, y] = self.at(center_world);
        Circle::new()
            .set("cx", px(x))
            .set("cy", px(y))
            .set("r", px(radius_m * self.scale_px_per_m))
    }

    /// Draws text centred on a point.
    pub fn label(&mut self, at_world: Point, text: &str, look: (&str, f64)) {
        let ((color, size_px), place) = (look, self.at(at_world));
        if let Sheet::Pixels(raster) = &mut self.sheet {
            return raster.text((place, Align::Center), text, size_px, (color, None));
        }
        let label = self.words(at_world, text, look);
        self.add(label);
    }

    /// The same with an outline of another colour, readable on any background.
    pub fn rimmed_label(
        &mut self,
        at_world: Point,
        text: &str,
        ((color, rim), size_px): ((&str, &str), f64),
    ) {
        let place = self.at(at_world);
        if let Sheet::Pixels(raster) = &mut self.sheet {
            return raster.text((place, Align::Center), text, size_px, (color, Some(rim)));
        }
        let label = self
            .words(at_world, text, (color, size_px))
            .set("stroke", rim)
            .set("stroke-width", px(size_px * 0.22))
            .set("stroke-linejoin", "round")
            .set("paint-order", "stroke");
        self.add(label);
    }

    fn words(&self, at_world: Point, text: &str, (color, size_px): (&str, f64)) -> Text {
        let [x, y] = self.at(at_world);
        Text::new(text)
            .set("x", px(x))
            .set("y", px(y + size_px * 0.36))
            .set("font-size", px(size_px))
            .set("font-weight", 600)
            .set("text-anchor", "middle")
            .set("fill", color)
    }

    fn add(&mut self, element: impl Into<Element>) {
        if let Sheet::Svg(map) = &mut self.sheet {
            map.append(element.into());
        }
    }

    /// The whole SVG document with header and footer; of pixels without the map.
    pub fn finish(self, foot_px: f64, around: Group) -> String {
        let map = match self.sheet {
            Sheet::Svg(map) => map,
            Sheet::Pixels(_) => Group::new(),
        };
        let [width_px, map_px] = self.size_px;
        let height_px = HEAD_PX + map_px + foot_px;
        let rectangle = |y: f64, height: f64, color: &str| {
            Rectangle::new()
                .set("y", px(y))
                .set("width", px(width_px))
                .set("height", px(height))
                .set("fill", color)
        };
        let clip =
            ClipPath::new()
                .set("id", "ground")
                .add(rectangle(HEAD_PX, map_px, palette::GROUND));
        let document = Document::new()
            .set("viewBox", format!("0 0 {} {}", px(width_px), px(height_px)))
            .set("width", px(width_px))
            .set("height", px(height_px))
            .set("font-family", "Inter, 'Helvetica Neue', Arial, sans-serif")
            .add(rectangle(0.0, height_px, palette::PAPER))
            .add(rectangle(HEAD_PX, map_px, palette::GROUND))
            .add(Definitions::new().add(clip))
            .add(map.set("clip-path", "url(#ground)"))
            .add(around);
        format!("{document}\n")
    }
}

/// A number with at most two decimals, which keeps files small and readable.
pub fn px(value: f64) -> String {
    let text = format!("{value:.2}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}
