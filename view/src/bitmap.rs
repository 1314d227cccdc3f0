//! Pictures of pixels whose words are spaced as their face says.
//!
//! The library's own rasteriser leaves out the room before each letter and begins each
//! at a whole pixel: "cyclictest" reads "cydictest", and words at an edge lose a part of
//! their letters.

use ab_glyph::{Font, FontRef, ScaleFont, point};
use epaint_default_fonts::UBUNTU_LIGHT;
use plotters::prelude::BitMapBackend;
use plotters::style::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind,
};

/// Where the letters stand below the point that words are placed by, as a share of their
/// size, which is 1.12 em of the face: b and k are 0.78 em high, capitals 0.69.
const BELOW_TOP: f32 = 0.75;
const BELOW_CENTER: f32 = 0.31;
const ABOVE_BOTTOM: f32 = 0.22;

/// A picture of pixels.
pub struct Bitmap<'a>(pub BitMapBackend<'a>);

type Refused = DrawingErrorKind<<BitMapBackend<'static> as DrawingBackend>::ErrorType>;

impl DrawingBackend for Bitmap<'_> {
    type ErrorType = <BitMapBackend<'static> as DrawingBackend>::ErrorType;

    fn get_size(&self) -> (u32, u32) {
        self.0.get_size()
    }

    fn ensure_prepared(&mut self) -> Result<(), Refused> {
        self.0.ensure_prepared()
    }

    fn present(&mut self) -> Result<(), Refused> {
        self.0.present()
    }

    fn draw_pixel(&mut self, at: BackendCoord, colour: BackendColor) -> Result<(), Refused> {
        self.0.draw_pixel(at, colour)
    }

    fn draw_line<S: BackendStyle>(
        &mut self,
        from: BackendCoord,
        to: BackendCoord,
        style: &S,
    ) -> Result<(), Refused> {
        self.0.draw_line(from, to, style)
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        from: BackendCoord,
        to: BackendCoord,
        style: &S,
        fill: bool,
    ) -> Result<(), Refused> {
        self.0.draw_rect(from, to, style, fill)
    }

    fn draw_text<S: BackendTextStyle>(
        &mut self,
        text: &str,
        style: &S,
        (x, y): BackendCoord,
    ) -> Result<(), Refused> {
        let face = FontRef::try_from_slice(UBUNTU_LIGHT)
            .map_err(|error| DrawingErrorKind::FontError(Box::new(error)))?;
        let face = face.as_scaled(style.size() as f32);
        let (mut letters, mut width, mut before) = (Vec::new(), 0.0, None);
        for letter in text.chars().map(|letter| face.glyph_id(letter)) {
            width += before.map_or(0.0, |before| face.kern(before, letter));
            letters.push((letter, width));
            width += face.h_advance(letter);
            before = Some(letter);
        }
        let left = match style.anchor().h_pos {
            HPos::Left => 0.0,
            HPos::Center => -width / 2.0,
            HPos::Right => -width,
        };
        let down = style.size() as f32
            * match style.anchor().v_pos {
                VPos::Top => BELOW_TOP,
                VPos::Center => BELOW_CENTER,
                VPos::Bottom => -ABOVE_BOTTOM,
            };
        let mut drawn = Ok(());
        for (letter, begin) in letters {
            let letter = letter.with_scale_and_position(face.scale(), point(left + begin, down));
            // A space has none.
            let Some(outline) = face.outline_glyph(letter) else {
                continue;
            };
            let corner = outline.px_bounds().min;
            outline.draw(|column, row, cover| {
                let column = corner.x as i32 + column as i32;
                let row = corner.y as i32 + row as i32;
                let (right, down) = style.transform().transform(column, row);
                let mut colour = style.color();
                colour.alpha *= f64::from(cover.min(1.0));
                if drawn.is_ok() {
                    drawn = self.draw_pixel((x + right, y + down), colour);
                }
            });
        }
        drawn
    }

    fn blit_bitmap(
        &mut self,
        at: BackendCoord,
        size: (u32, u32),
        pixels: &[u8],
    ) -> Result<(), Refused> {
        self.0.blit_bitmap(at, size, pixels)
    }
}

#[cfg(test)]
mod tests {
    use plotters::prelude::*;

    use super::*;
    use crate::chart::{FACE, know_font, write};

    const SIZE: (u32, u32) = (100, 40);

    /// The columns, or rows, with ink: from the first of each run to its last.
    fn runs(pixels: &[u8], lines: u32, at: impl Fn(u32, u32) -> (u32, u32)) -> Vec<(u32, u32)> {
        let (width, height) = SIZE;
        let across = if lines == width { height } else { width };
        let has_ink = |line: &u32| {
            (0..across).any(|other| {
                let (x, y) = at(*line, other);
                pixels[3 * (y * width + x) as usize] < 200
            })
        };
        let mut runs: Vec<(u32, u32)> = Vec::new();
        for line in (0..lines).filter(has_ink) {
            match runs.last_mut() {
                Some((_, last)) if *last + 1 == line => *last = line,
                _ => runs.push((line, line)),
            }
        }
        runs
    }

    fn draw(paint: impl FnOnce(&DrawingArea<Bitmap<'_>, plotters::coord::Shift>)) -> Vec<u8> {
        know_font().expect("the font");
        let mut pixels = vec![255; (3 * SIZE.0 * SIZE.1) as usize];
        let root = Bitmap(BitMapBackend::with_buffer(&mut pixels, SIZE)).into_drawing_area();
        paint(&root);
        drop(root);
        pixels
    }

    #[test]
    fn letters_keep_the_room_between_them() {
        let pixels = draw(|root| write(root, "clcl", (4, 4), (24, BLACK)).expect("drawn"));
        let runs = runs(&pixels, SIZE.0, |x, y| (x, y));
        assert_eq!(runs.len(), 4, "c and l do not make a d: {runs:?}");
        let gaps: Vec<u32> = runs.windows(2).map(|two| two[1].0 - two[0].1).collect();
        assert!(gaps[0].abs_diff(gaps[2]) <= 1, "{runs:?}");
    }

    #[test]
    fn words_at_the_left_edge_are_whole() {
        let pixels = draw(|root| {
            let style = (FACE, 13).into_font().transform(FontTransform::Rotate270);
            let at = plotters::style::text_anchor::Pos::new(HPos::Center, VPos::Top);
            let style = TextStyle::from(style).pos(at);
            root.draw_text("bfkl", &style, (0, 20)).expect("drawn");
        });
        // As tall as upright ones.
        let upright = draw(|root| write(root, "bfkl", (4, 4), (13, BLACK)).expect("drawn"));
        let height = |runs: Vec<(u32, u32)>| runs[runs.len() - 1].1 - runs[0].0;
        let turned = height(runs(&pixels, SIZE.0, |x, y| (x, y)));
        let upright = height(runs(&upright, SIZE.1, |y, x| (x, y)));
        assert_eq!(turned, upright);
    }
}
