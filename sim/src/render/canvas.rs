//! Draws polygons on pixels.

use shm_config::palette::Rgb;
use tiny_skia::{Color, FillRule, Paint, PathBuilder, Pixmap, Stroke, Transform};

/// How far outside the picture polygons are kept, pixels, so that neither their cut
/// edge nor a rim along it is visible.
const MARGIN_PX: f64 = 16.0;

/// A polygon, in pixels.
pub type Outline = Vec<[f64; 2]>;

/// A picture under way.
pub struct Canvas {
    pixmap: Pixmap,
    rgb: Vec<u8>,
    /// Buffer for a polygon while it is clipped.
    cut: [Outline; 2],
}

impl Canvas {
    /// A black picture; `None` when it has no pixels or far too many.
    pub fn new([width, height]: [u32; 2]) -> Option<Canvas> {
        Some(Canvas {
            pixmap: Pixmap::new(width, height)?,
            rgb: Vec::new(),
            cut: Default::default(),
        })
    }

    /// Width and height, pixels.
    pub fn size_px(&self) -> [u32; 2] {
        [self.pixmap.width(), self.pixmap.height()]
    }

    /// Fills the whole picture.
    pub fn clear(&mut self, [red, green, blue]: Rgb) {
        self.pixmap.fill(Color::from_rgba8(red, green, blue, 255));
    }

    /// Fills the union of these polygons, which must all have the same orientation, so
    /// that no seam is left between neighbours. Opacity in (0, 1].
    pub fn fill<'a>(
        &mut self,
        outlines: impl IntoIterator<Item = &'a Outline>,
        color: Rgb,
        opacity: f64,
    ) {
        let mut builder = PathBuilder::new();
        for outline in outlines {
            self.add(outline, &mut builder);
        }
        if let Some(path) = builder.finish() {
            let (rule, still) = (FillRule::Winding, Transform::identity());
            self.pixmap
                .fill_path(&path, &paint(color, opacity), rule, still, None);
        }
    }

    /// Draws a polygon's rim, that many pixels wide.
    pub fn rim(&mut self, outline: &Outline, color: Rgb, width_px: f64) {
        let mut builder = PathBuilder::new();
        self.add(outline, &mut builder);
        let stroke = Stroke {
            width: width_px as f32,
            line_join: tiny_skia::LineJoin::Round,
            ..Stroke::default()
        };
        if let Some(path) = builder.finish() {
            let still = Transform::identity();
            self.pixmap
                .stroke_path(&path, &paint(color, 1.0), &stroke, still, None);
        }
    }

    /// Adds the part of a polygon near the picture: the rasteriser works with small
    /// numbers, and near the camera a road is as wide as a thousand pictures.
    fn add(&mut self, outline: &Outline, builder: &mut PathBuilder) {
        let [width, height] = self.size_px().map(f64::from);
        let [from, to] = &mut self.cut;
        from.clear();
        from.extend_from_slice(outline);
        for (axis, sign, limit) in [
            (0, 1.0, -MARGIN_PX),
            (0, -1.0, -width - MARGIN_PX),
            (1, 1.0, -MARGIN_PX),
            (1, -1.0, -height - MARGIN_PX),
        ] {
            cut(from, to, |pixel| sign * pixel[axis] - limit);
            std::mem::swap(from, to);
        }
        if from.len() < 3 {
            return;
        }
        for (index, [u, v]) in from
            .iter()
            .map(|pixel| pixel.map(|at| at as f32))
            .enumerate()
        {
            match index {
                0 => builder.move_to(u, v),
                _ => builder.line_to(u, v),
            }
        }
        builder.close();
    }

    /// The pixels, row by row from the top, three bytes each.
    pub fn rgb(&mut self) -> &[u8] {
        self.rgb.clear();
        // Every pixel was painted, so none is transparent.
        let pixels = self.pixmap.data().chunks_exact(4);
        self.rgb
            .extend(pixels.flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]));
        &self.rgb
    }
}

fn paint([red, green, blue]: Rgb, opacity: f64) -> Paint<'static> {
    let mut paint = Paint::default();
    let alpha = (opacity.clamp(0.0, 1.0) * 255.0).round() as u8;
    paint.set_color_rgba8(red, green, blue, alpha);
    paint
}

/// The part of a polygon where `inside` is not negative (Sutherland and Hodgman).
fn cut(outline: &Outline, out: &mut Outline, inside: impl Fn(&[f64; 2]) -> f64) {
    out.clear();
    for (index, from) in outline.iter().enumerate() {
        let to = &outline[(index + 1) % outline.len()];
        let (here, there) = (inside(from), inside(to));
        if here >= 0.0 {
            out.push(*from);
        }
        if (here >= 0.0) != (there >= 0.0) {
            let share = here / (here - there);
            out.push([0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * share));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INK: Rgb = [10, 200, 30];

    fn pixel(canvas: &mut Canvas, u: usize, v: usize) -> Rgb {
        let width = canvas.size_px()[0] as usize;
        let at = (v * width + u) * 3;
        let rgb = canvas.rgb();
        [rgb[at], rgb[at + 1], rgb[at + 2]]
    }

    #[test]
    fn polygons_larger_than_the_picture_are_filled_where_they_are() {
        let mut canvas = Canvas::new([100, 80]).expect("a picture");
        canvas.clear([0, 0, 0]);
        // The area left of u = 50, with very large coordinates.
        let far = 1e12;
        let half = vec![[-far, -far], [50.0, -far], [50.0, far], [-far, far]];
        canvas.fill([&half], INK, 1.0);
        for v in [0, 40, 79] {
            assert_eq!(pixel(&mut canvas, 0, v), INK);
            assert_eq!(pixel(&mut canvas, 49, v), INK);
            assert_eq!(pixel(&mut canvas, 50, v), [0, 0, 0]);
        }
    }

    #[test]
    fn neighbours_leave_no_seam() {
        let mut canvas = Canvas::new([64, 64]).expect("a picture");
        canvas.clear([255, 255, 255]);
        let edge = 31.37;
        let left = vec![[0.0, 0.0], [0.0, 64.0], [edge, 64.0], [edge, 0.0]];
        let right = vec![[edge, 0.0], [edge, 64.0], [64.0, 64.0], [64.0, 0.0]];
        canvas.fill([&left, &right], INK, 1.0);
        for u in 0..64 {
            assert_eq!(pixel(&mut canvas, u, 32), INK, "{u}");
        }
    }

    #[test]
    fn a_polygon_outside_the_picture_changes_nothing() {
        let mut canvas = Canvas::new([64, 64]).expect("a picture");
        canvas.clear([1, 2, 3]);
        let beside = vec![[100.0, 0.0], [200.0, 0.0], [200.0, 64.0]];
        canvas.fill([&beside, &Vec::new(), &vec![[1.0, 1.0]]], INK, 1.0);
        canvas.rim(&beside, INK, 2.0);
        assert!(canvas.rgb().chunks_exact(3).all(|pixel| pixel == [1, 2, 3]));
        assert!(Canvas::new([0, 10]).is_none());
    }
}
