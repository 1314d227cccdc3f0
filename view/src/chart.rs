//! What charts have in common: their face, colours, words and legends.

use std::sync::OnceLock;

use anyhow::anyhow;
use plotters::prelude::*;
use plotters::style::register_font;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::sheet::Area;

/// The face that everything is written in; the pictures need no font of the
/// machine.
pub const FACE: &str = "sans-serif";
/// Words.
pub const INK: RGBColor = RGBColor(34, 40, 49);
/// What stands back.
pub const FAINT: RGBColor = RGBColor(110, 118, 129);
/// Lines of the scales.
pub const GRID: RGBColor = RGBColor(228, 231, 235);
/// Length of a legend's line, pixels.
pub const SWATCH: i32 = 26;

/// Makes the face known.
///
/// # Errors
/// When it cannot be read.
pub(crate) fn know_font() -> anyhow::Result<()> {
    static FONT: OnceLock<bool> = OnceLock::new();
    let known = FONT.get_or_init(|| {
        register_font(FACE, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT).is_ok()
    });
    match known {
        true => Ok(()),
        false => Err(anyhow!("the font cannot be read")),
    }
}

/// Words from their left upper corner.
///
/// # Errors
/// When the picture cannot be drawn on.
pub fn write(
    area: &Area<'_>,
    words: &str,
    at: (i32, i32),
    (size, colour): (u32, RGBColor),
) -> anyhow::Result<()> {
    let style = TextStyle::from((FACE, size).into_font())
        .color(&colour)
        .pos(Pos::new(HPos::Left, VPos::Top));
    area.draw_text(words, &style, at)?;
    Ok(())
}

/// One name of a legend with its line; where the next one begins.
///
/// # Errors
/// When the picture cannot be drawn on.
pub fn legend_entry(
    area: &Area<'_>,
    name: &str,
    style: impl Into<ShapeStyle>,
    (x, y): (i32, i32),
) -> anyhow::Result<i32> {
    let style: ShapeStyle = style.into();
    area.draw(&PathElement::new([(x, y), (x + SWATCH, y)], style))?;
    write(area, name, (x + SWATCH + 8, y - 6), (16, INK))?;
    let font = TextStyle::from((FACE, 16).into_font());
    let (width, _) = area.estimate_text_size(name, &font)?;
    Ok(x + SWATCH + 8 + width as i32 + 26)
}
