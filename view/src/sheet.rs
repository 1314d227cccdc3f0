//! Draws a chart as SVG and as PNG with the same code.
//!
//! In PNG files, text is spaced by the font's metrics. The rasteriser of the plotting library
//! ignores the space before each letter and rounds its position to whole pixels, so that
//! "cyclictest" reads "cydictest" and letters at an edge are cut off.

use std::io;
use std::path::Path;

use ab_glyph::{Font, FontRef, ScaleFont, point};
use anyhow::Context;
use epaint_default_fonts::UBUNTU_LIGHT;
use image::ColorType;
use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, IntoDrawingArea};
use plotters::prelude::{BitMapBackend, SVGBackend, WHITE};
use plotters::style::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind,
};

use crate::chart::register_chart_font;

/// Distance from the anchor point of a text to its baseline, as a share of the font size
/// (1.12 em of this font): b and k are 0.78 em high, capitals 0.69 em.
const BELOW_TOP: f32 = 0.75;
const BELOW_CENTER: f32 = 0.31;
const ABOVE_BOTTOM: f32 = 0.22;

/// The file format that a chart is drawn in.
pub enum Sheet<'a> {
    /// Shapes and text.
    Svg(SVGBackend<'a>),
    /// Pixels.
    Pixels(BitMapBackend<'a>),
}

/// A part of a sheet; coordinates are pixels from its upper left corner.
pub type Area<'a> = DrawingArea<Sheet<'a>, Shift>;

/// Draws `NAME.svg` and `NAME.png` into a folder, `size` pixels wide and high, on white.
///
/// # Errors
/// If a file cannot be written.
pub fn save(
    folder: &Path,
    name: &str,
    size: (u32, u32),
    paint: impl Fn(&Area<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    save_svg(&folder.join(format!("{name}.svg")), size, &paint)?;
    let path = folder.join(format!("{name}.png"));
    let (width, height) = size;
    let mut pixels = vec![0; 3 * width as usize * height as usize];
    let sheet = Sheet::Pixels(BitMapBackend::with_buffer(&mut pixels, size));
    fill(sheet, &paint).with_context(|| path.display().to_string())?;
    image::save_buffer(&path, &pixels, width, height, ColorType::Rgb8)
        .with_context(|| path.display().to_string())
}

/// Draws an SVG file, `size` pixels wide and high, on white.
///
/// # Errors
/// If it cannot be written.
pub fn save_svg(
    path: &Path,
    size: (u32, u32),
    paint: impl Fn(&Area<'_>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let sheet = Sheet::Svg(SVGBackend::new(path, size));
    fill(sheet, paint).with_context(|| path.display().to_string())
}

fn fill(sheet: Sheet<'_>, paint: impl Fn(&Area<'_>) -> anyhow::Result<()>) -> anyhow::Result<()> {
    register_chart_font()?;
    let area = sheet.into_drawing_area();
    area.fill(&WHITE)?;
    paint(&area)?;
    area.present()?;
    Ok(())
}

type Refused = DrawingErrorKind<io::Error>;

fn refused<E: std::error::Error + Send + Sync>(error: DrawingErrorKind<E>) -> Refused {
    match error {
        DrawingErrorKind::DrawingError(error) => {
            DrawingErrorKind::DrawingError(io::Error::other(error.to_string()))
        }
        DrawingErrorKind::FontError(error) => DrawingErrorKind::FontError(error),
    }
}

/// Forwards a call to the backend of the file format.
macro_rules! on {
    ($sheet:expr, $call:ident($($argument:expr),*)) => {
        match $sheet {
            Sheet::Svg(svg) => svg.$call($($argument),*).map_err(refused),
            Sheet::Pixels(pixels) => pixels.$call($($argument),*).map_err(refused),
        }
    };
}

impl DrawingBackend for Sheet<'_> {
    type ErrorType = io::Error;

    fn get_size(&self) -> (u32, u32) {
        match self {
            Sheet::Svg(svg) => svg.get_size(),
            Sheet::Pixels(pixels) => pixels.get_size(),
        }
    }

    fn ensure_prepared(&mut self) -> Result<(), Refused> {
        on!(self, ensure_prepared())
    }

    fn present(&mut self) -> Result<(), Refused> {
        on!(self, present())
    }

    fn draw_pixel(&mut self, at: BackendCoord, colour: BackendColor) -> Result<(), Refused> {
        on!(self, draw_pixel(at, colour))
    }

    fn draw_line<S: BackendStyle>(
        &mut self,
        from: BackendCoord,
        to: BackendCoord,
        style: &S,
    ) -> Result<(), Refused> {
        on!(self, draw_line(from, to, style))
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        from: BackendCoord,
        to: BackendCoord,
        style: &S,
        fill: bool,
    ) -> Result<(), Refused> {
        on!(self, draw_rect(from, to, style, fill))
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Result<(), Refused> {
        on!(self, draw_path(path, style))
    }

    fn draw_circle<S: BackendStyle>(
        &mut self,
        center: BackendCoord,
        radius: u32,
        style: &S,
        fill: bool,
    ) -> Result<(), Refused> {
        on!(self, draw_circle(center, radius, style, fill))
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        corners: I,
        style: &S,
    ) -> Result<(), Refused> {
        on!(self, fill_polygon(corners, style))
    }

    fn draw_text<S: BackendTextStyle>(
        &mut self,
        text: &str,
        style: &S,
        at: BackendCoord,
    ) -> Result<(), Refused> {
        match self {
            Sheet::Svg(svg) => svg.draw_text(text, style, at).map_err(refused),
            Sheet::Pixels(pixels) => draw_words(pixels, text, style, at).map_err(refused),
        }
    }

    fn blit_bitmap(
        &mut self,
        at: BackendCoord,
        size: (u32, u32),
        pixels: &[u8],
    ) -> Result<(), Refused> {
        on!(self, blit_bitmap(at, size, pixels))
    }
}

fn draw_words<B: DrawingBackend, S: BackendTextStyle>(
    backend: &mut B,
    text: &str,
    style: &S,
    (x, y): BackendCoord,
) -> Result<(), DrawingErrorKind<B::ErrorType>> {
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
        // A space has no glyph.
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
                drawn = backend.draw_pixel((x + right, y + down), colour);
            }
        });
    }
    drawn
}

#[cfg(test)]
mod tests {
    use plotters::prelude::*;

    use super::*;
    use crate::chart::{FACE, write};

    const SIZE: (u32, u32) = (100, 40);

    /// The columns or rows with ink, as runs from first to last.
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

    fn draw(paint: impl Fn(&Area<'_>) -> anyhow::Result<()>) -> Vec<u8> {
        let mut pixels = vec![0; (3 * SIZE.0 * SIZE.1) as usize];
        let sheet = Sheet::Pixels(BitMapBackend::with_buffer(&mut pixels, SIZE));
        fill(sheet, paint).expect("drawn");
        pixels
    }

    #[test]
    fn letters_keep_their_spacing() {
        let pixels = draw(|root| write(root, "clcl", (4, 4), (24, BLACK)));
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
            Ok(root.draw_text("bfkl", &style, (0, 20))?)
        });
        // As tall as horizontal letters.
        let upright = draw(|root| write(root, "bfkl", (4, 4), (13, BLACK)));
        let height = |runs: Vec<(u32, u32)>| runs[runs.len() - 1].1 - runs[0].0;
        let turned = height(runs(&pixels, SIZE.0, |x, y| (x, y)));
        let upright = height(runs(&upright, SIZE.1, |y, x| (x, y)));
        assert_eq!(turned, upright);
    }
}
