//! Words in a picture, from a font that the program carries.

use ab_glyph::{Font, FontRef, OutlineCurve, ScaleFont};
use tiny_skia::{Path, PathBuilder};

/// A font with open shapes, legible at 10 pixels.
const FACE: &[u8] = epaint_default_fonts::HACK_REGULAR;

/// The outline of a word, whose base line begins at a point, and its width, px. The
/// outline is `None` for blanks alone.
pub fn word(text: &str, [x, y]: [f32; 2], size_px: f32) -> (Option<Path>, f32) {
    // Always succeeds: the font is part of the program, and a test reads it.
    let Ok(font) = FontRef::try_from_slice(FACE) else {
        return (None, 0.0);
    };
    let scaled = font.as_scaled(size_px);
    let factor = scaled.scale_factor();
    let mut builder = PathBuilder::new();
    let mut advance_px = 0.0;
    for letter in text.chars() {
        let glyph = font.glyph_id(letter);
        let at = |point: ab_glyph::Point| {
            let right = x + advance_px + point.x * factor.horizontal;
            (right, y - point.y * factor.vertical)
        };
        for_each_contour(font.outline(glyph), at, &mut builder);
        advance_px += scaled.h_advance(glyph);
    }
    (builder.finish(), advance_px)
}

/// Height of a capital letter, px.
pub fn capital_px(size_px: f32) -> f32 {
    // Hack's capitals are 1493 of 2384 units between ascent and descent.
    0.626 * size_px
}

fn for_each_contour(
    outline: Option<ab_glyph::Outline>,
    at: impl Fn(ab_glyph::Point) -> (f32, f32),
    builder: &mut PathBuilder,
) {
    let mut end = None;
    for curve in outline.into_iter().flat_map(|outline| outline.curves) {
        let (from, to) = match curve {
            OutlineCurve::Line(a, b) => (a, b),
            OutlineCurve::Quad(a, _, c) => (a, c),
            OutlineCurve::Cubic(a, _, _, d) => (a, d),
        };
        if end != Some(from) {
            if end.is_some() {
                builder.close();
            }
            let (x, y) = at(from);
            builder.move_to(x, y);
        }
        let (x, y) = at(to);
        match curve {
            OutlineCurve::Line(..) => builder.line_to(x, y),
            OutlineCurve::Quad(_, b, _) => {
                let (x1, y1) = at(b);
                builder.quad_to(x1, y1, x, y);
            }
            OutlineCurve::Cubic(_, b, c, _) => {
                let ((x1, y1), (x2, y2)) = (at(b), at(c));
                builder.cubic_to(x1, y1, x2, y2, x, y);
            }
        }
        end = Some(to);
    }
    if end.is_some() {
        builder.close();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_have_a_shape_and_a_width() {
        let (path, width_px) = word("AB", [10.0, 50.0], 20.0);
        let bounds = path.expect("a shape").bounds();
        assert!(bounds.left() > 9.0 && bounds.right() < 10.0 + width_px + 1.0);
        assert!((bounds.bottom() - 50.0).abs() < 1.0, "{bounds:?}");
        let capital = bounds.height();
        assert!((capital - capital_px(20.0)).abs() < 1.0, "{capital}");
        assert!(word(" ", [0.0, 0.0], 20.0).0.is_none());
    }
}
