//! Drawing on an image: anti-aliased lines, discs and words.

use image::RgbImage;
use tiny_skia::{
    Color, FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, Stroke, Transform,
};

use super::letters;

/// A position in the picture, px right and down.
pub type Place = [f32; 2];

/// Pixels further outside the picture than this are not drawn: near the camera a line
/// may be a million pixels long.
const BEYOND_PX: f32 = 4096.0;

/// A picture to draw into.
pub struct Pencil {
    pixmap: Pixmap,
}

impl Pencil {
    /// Draws on top of an image; `None` when the image has no pixels.
    pub fn on(image: &RgbImage) -> Option<Self> {
        let mut pixmap = Pixmap::new(image.width(), image.height())?;
        let places = pixmap.data_mut().chunks_exact_mut(4);
        for (place, pixel) in places.zip(image.pixels()) {
            place[..3].copy_from_slice(&pixel.0);
            place[3] = u8::MAX;
        }
        Some(Self { pixmap })
    }

    /// Width and height, px.
    pub fn size_px(&self) -> [f32; 2] {
        [self.pixmap.width() as f32, self.pixmap.height() as f32]
    }

    /// A line through positions, with round ends.
    pub fn line(&mut self, places: &[Place], color: [u8; 3], width_px: f32) {
        if let Some(path) = polyline(places) {
            self.stroke(&path, color, width_px);
        }
    }

    /// A closed line through positions.
    pub fn outline(&mut self, places: &[Place], color: [u8; 3], width_px: f32) {
        let closed: Vec<Place> = places.iter().chain(places.first()).copied().collect();
        self.line(&closed, color, width_px);
    }

    /// A filled circle.
    pub fn disc(&mut self, [x, y]: Place, radius_px: f32, color: [u8; 3]) {
        if let Some(path) = PathBuilder::from_circle(x, y, radius_px) {
            self.fill(&path, color, 1.0);
        }
    }

    /// A filled rectangle from its left upper corner.
    pub fn panel(&mut self, [x, y]: Place, [width, height]: [f32; 2], color: [u8; 3], cover: f32) {
        if let Some(rect) = tiny_skia::Rect::from_xywh(x, y, width, height) {
            self.fill(&PathBuilder::from_rect(rect), color, cover);
        }
    }

    /// A word whose base line begins at a position; returns its width, px.
    pub fn word(&mut self, text: &str, at: Place, (size_px, color): (f32, [u8; 3])) -> f32 {
        let (path, width_px) = letters::word(text, at, size_px);
        if let Some(path) = path {
            self.fill(&path, color, 1.0);
            // The font has one weight; a rim of the same colour makes it bold.
            self.stroke(&path, color, size_px * 0.05);
        }
        width_px
    }

    fn fill(&mut self, path: &Path, color: [u8; 3], cover: f32) {
        let paint = paint(color, cover);
        let identity = Transform::identity();
        self.pixmap
            .fill_path(path, &paint, FillRule::Winding, identity, None);
    }

    fn stroke(&mut self, path: &Path, color: [u8; 3], width_px: f32) {
        let stroke = Stroke {
            width: width_px,
            line_cap: LineCap::Round,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        let identity = Transform::identity();
        self.pixmap
            .stroke_path(path, &paint(color, 1.0), &stroke, identity, None);
    }

    /// The picture.
    pub fn finish(self) -> RgbImage {
        let (width, height) = (self.pixmap.width(), self.pixmap.height());
        let bytes = self.pixmap.data().chunks_exact(4);
        let rgb = bytes.flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]);
        RgbImage::from_vec(width, height, rgb.collect()).unwrap_or_default()
    }
}

fn paint(color: [u8; 3], cover: f32) -> Paint<'static> {
    let [red, green, blue] = color;
    let mut paint = Paint::default();
    let mut color = Color::from_rgba8(red, green, blue, u8::MAX);
    color.apply_opacity(cover);
    paint.set_color(color);
    paint.anti_alias = true;
    paint
}

/// A path through positions; a single position is a dot.
fn polyline(places: &[Place]) -> Option<Path> {
    let inside = |[x, y]: Place| {
        let limit = |value: f32| value.clamp(-BEYOND_PX, 2.0 * BEYOND_PX);
        (limit(x), limit(y))
    };
    let (x, y) = inside(*places.first()?);
    let mut builder = PathBuilder::new();
    builder.move_to(x, y);
    // A line without length has no ends that could be rounded.
    builder.line_to(x + 0.01, y);
    for &place in &places[1..] {
        let (x, y) = inside(place);
        builder.line_to(x, y);
    }
    builder.finish()
}
