//! Lines, areas and letters as pixels, for pictures that move.

use ab_glyph::{Font, FontRef, OutlineCurve, Point as Corner, ScaleFont};
use epaint_default_fonts::UBUNTU_LIGHT;
use tiny_skia::{
    Color, FillRule, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, StrokeDash, Transform,
};

/// Height of capital letters over the size of the font.
const CAPITALS: f32 = 0.69;

/// A picture in pixels.
pub struct Raster {
    pixmap: Pixmap,
}

/// How a line is drawn, in pixels.
#[derive(Clone, Copy)]
pub struct Pen<'a> {
    /// `#rrggbb`.
    pub color: &'a str,
    /// Width, px.
    pub width_px: f64,
    /// Opacity, (0, 1].
    pub opacity: f64,
    /// Lengths of dash and gap, px.
    pub dash_px: Option<[f64; 2]>,
}

/// Where a text lies from its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Align {
    /// It begins there.
    Left,
    /// It is centred there.
    Center,
    /// It ends there.
    Right,
}

/// Red, green and blue of `#rrggbb`; black for anything else, which the palette has not.
pub fn rgb(color: &str) -> [u8; 3] {
    let part = |at: usize| {
        let digits = color.get(1 + 2 * at..3 + 2 * at);
        digits.and_then(|digits| u8::from_str_radix(digits, 16).ok())
    };
    [0, 1, 2].map(|at| part(at).unwrap_or(0))
}

fn paint(color: &str, opacity: f64) -> Paint<'static> {
    let [red, green, blue] = rgb(color);
    let mut paint = Paint::default();
    paint.set_color_rgba8(red, green, blue, (opacity * 255.0).round() as u8);
    paint
}

fn path(points: &[[f64; 2]], is_closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    for (index, [x, y]) in points.iter().enumerate() {
        match index {
            0 => path.move_to(*x as f32, *y as f32),
            _ => path.line_to(*x as f32, *y as f32),
        }
    }
    if is_closed {
        path.close();
    }
    path.finish()
}

impl Raster {
    /// A picture of one colour; `None` when it has no pixels, or more than memory holds.
    pub fn new([width, height]: [u32; 2], color: &str) -> Option<Raster> {
        let mut pixmap = Pixmap::new(width, height)?;
        let [red, green, blue] = rgb(color);
        pixmap.fill(Color::from_rgba8(red, green, blue, 255));
        Some(Raster { pixmap })
    }

    /// Row by row from the top, red, green and blue.
    pub fn rgb(&self) -> Vec<u8> {
        let pixels = self.pixmap.data().chunks_exact(4);
        pixels
            .flat_map(|pixel| [pixel[0], pixel[1], pixel[2]])
            .collect()
    }

    /// Draws a line through points.
    pub fn line(&mut self, points: &[[f64; 2]], pen: Pen) {
        self.trace(path(points, false), pen);
    }

    /// Draws a filled polygon.
    pub fn area(&mut self, corners: &[[f64; 2]], color: &str, opacity: f64) {
        self.fill(path(corners, true), color, opacity);
    }

    /// Draws the outline of a polygon.
    pub fn outline(&mut self, corners: &[[f64; 2]], pen: Pen) {
        self.trace(path(corners, true), pen);
    }

    /// Draws a filled circle.
    pub fn disc(&mut self, [x, y]: [f64; 2], radius_px: f64, color: &str) {
        let circle = PathBuilder::from_circle(x as f32, y as f32, radius_px as f32);
        self.fill(circle, color, 1.0);
    }

    /// Draws a circle.
    pub fn ring(&mut self, [x, y]: [f64; 2], radius_px: f64, pen: Pen) {
        let circle = PathBuilder::from_circle(x as f32, y as f32, radius_px as f32);
        self.trace(circle, pen);
    }

    /// Draws text; its capital letters are centred on the point in height. A rim of another
    /// colour keeps it readable on any background.
    pub fn text(
        &mut self,
        (at, align): ([f64; 2], Align),
        text: &str,
        size_px: f64,
        (color, rim): (&str, Option<&str>),
    ) {
        let Some(letters) = letters(text, (at, align), size_px as f32) else {
            return;
        };
        if let Some(rim) = rim {
            let pen = Pen {
                color: rim,
                width_px: size_px * 0.22,
                opacity: 1.0,
                dash_px: None,
            };
            self.trace(Some(letters.clone()), pen);
        }
        self.fill(Some(letters.clone()), color, 1.0);
        // The font is light; a thin line of the same colour makes small letters readable.
        let pen = Pen {
            color,
            width_px: size_px * 0.045,
            opacity: 1.0,
            dash_px: None,
        };
        self.trace(Some(letters), pen);
    }

    /// Width of a text, px.
    pub fn width_px(text: &str, size_px: f64) -> f64 {
        font().map_or(0.0, |font| f64::from(advance(&font, text, size_px as f32)))
    }

    fn fill(&mut self, path: Option<Path>, color: &str, opacity: f64) {
        if let Some(path) = path {
            let paint = paint(color, opacity);
            let (rule, place) = (FillRule::Winding, Transform::identity());
            self.pixmap.fill_path(&path, &paint, rule, place, None);
        }
    }

    fn trace(&mut self, path: Option<Path>, pen: Pen) {
        let Some(path) = path else { return };
        let dash = pen
            .dash_px
            .and_then(|lengths| StrokeDash::new(lengths.map(|px| px as f32).to_vec(), 0.0));
        let stroke = Stroke {
            width: pen.width_px as f32,
            line_join: LineJoin::Round,
            dash,
            ..Stroke::default()
        };
        let (paint, place) = (paint(pen.color, pen.opacity), Transform::identity());
        self.pixmap.stroke_path(&path, &paint, &stroke, place, None);
    }
}

fn font() -> Option<FontRef<'static>> {
    // The font is compiled in; `letters_are_drawn` shows that it can be read.
    FontRef::try_from_slice(UBUNTU_LIGHT).ok()
}

fn advance(font: &FontRef, text: &str, size_px: f32) -> f32 {
    let scaled = font.as_scaled(size_px);
    let mut before = None;
    let mut width = 0.0;
    for letter in text.chars().map(|letter| font.glyph_id(letter)) {
        width += before.map_or(0.0, |before| scaled.kern(before, letter));
        width += scaled.h_advance(letter);
        before = Some(letter);
    }
    width
}

fn letters(text: &str, ([x, y], align): ([f64; 2], Align), size_px: f32) -> Option<Path> {
    let font = font()?;
    let scaled = font.as_scaled(size_px);
    let width = advance(&font, text, size_px);
    let left = match align {
        Align::Left => 0.0,
        Align::Center => -width / 2.0,
        Align::Right => -width,
    };
    let (mut pen, baseline) = (x as f32 + left, y as f32 + size_px * CAPITALS / 2.0);
    let scale = scaled.h_scale_factor();
    let mut path = PathBuilder::new();
    let mut before = None;
    for letter in text.chars().map(|letter| font.glyph_id(letter)) {
        pen += before.map_or(0.0, |before| scaled.kern(before, letter));
        before = Some(letter);
        // A space has no outline.
        if let Some(outline) = font.outline(letter) {
            let place = |corner: Corner| (pen + corner.x * scale, baseline - corner.y * scale);
            contours(&mut path, &outline.curves, place);
        }
        pen += scaled.h_advance(letter);
    }
    path.finish()
}

/// Adds the contours of a letter; one begins where the one before it does not end.
fn contours(path: &mut PathBuilder, curves: &[OutlineCurve], place: impl Fn(Corner) -> (f32, f32)) {
    let mut end = None;
    for curve in curves {
        let (OutlineCurve::Line(begin, _)
        | OutlineCurve::Quad(begin, ..)
        | OutlineCurve::Cubic(begin, ..)) = curve;
        if end != Some(*begin) {
            let (x, y) = place(*begin);
            path.move_to(x, y);
        }
        match curve {
            OutlineCurve::Line(_, to) => {
                let (x, y) = place(*to);
                path.line_to(x, y);
                end = Some(*to);
            }
            OutlineCurve::Quad(_, over, to) => {
                let ((cx, cy), (x, y)) = (place(*over), place(*to));
                path.quad_to(cx, cy, x, y);
                end = Some(*to);
            }
            OutlineCurve::Cubic(_, first, second, to) => {
                let ((ax, ay), (bx, by), (x, y)) = (place(*first), place(*second), place(*to));
                path.cubic_to(ax, ay, bx, by, x, y);
                end = Some(*to);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_drawn_where_they_belong() {
        let mut raster = Raster::new([100, 40], "#ffffff").expect("a picture");
        raster.text(([50.0, 20.0], Align::Center), "HI", 20.0, ("#000000", None));
        let pixels = raster.rgb();
        let dark: Vec<(usize, usize)> = (0..100 * 40)
            .filter(|at| pixels[3 * at] < 100)
            .map(|at| (at % 100, at / 100))
            .collect();
        let middle = |values: &dyn Fn(&(usize, usize)) -> usize| {
            let all: Vec<usize> = dark.iter().map(values).collect();
            let (least, most) = (all.iter().min(), all.iter().max());
            (least.expect("ink") + most.expect("ink")) as f64 / 2.0
        };
        assert!((middle(&|at| at.0) - 50.0).abs() < 2.5, "{dark:?}");
        assert!((middle(&|at| at.1) - 20.0).abs() < 2.0, "{dark:?}");
        assert!(Raster::width_px("HI", 20.0) > 10.0);
    }

    #[test]
    fn colours_are_read_as_the_palette_writes_them() {
        assert_eq!(rgb("#37d67a"), [0x37, 0xd6, 0x7a]);
        assert_eq!(rgb("none"), [0, 0, 0]);
    }
}
