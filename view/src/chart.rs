//! Font, colours, text and legends shared by all charts.

use std::sync::OnceLock;

use anyhow::anyhow;
use plotters::prelude::*;
use plotters::style::register_font;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::sheet::Area;

/// The font of all text; it is compiled in, so that pictures do not depend on the
/// machine's fonts.
pub const FACE: &str = "sans-serif";
/// Colour of text.
pub const INK: RGBColor = RGBColor(34, 40, 49);
/// Colour of secondary text and lines.
pub const FAINT: RGBColor = RGBColor(110, 118, 129);
/// Colour of grid lines.
pub const GRID: RGBColor = RGBColor(228, 231, 235);
/// Length of a line in the legend, pixels.
pub const SWATCH: i32 = 26;

/// Registers the font.
///
/// # Errors
/// If it cannot be read.
pub(crate) fn register_chart_font() -> anyhow::Result<()> {
    static FONT: OnceLock<bool> = OnceLock::new();
    let known = FONT.get_or_init(|| {
        register_font(FACE, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT).is_ok()
    });
    match known {
        true => Ok(()),
        false => Err(anyhow!("the font cannot be read")),
    }
}

/// Draws text; `at` is its upper left corner.
///
/// # Errors
/// If the picture cannot be drawn on.
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

/// Draws an entry of a legend with its line; returns where the next one begins.
///
/// # Errors
/// If the picture cannot be drawn on.
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
