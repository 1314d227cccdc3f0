//! Plots memory over ticks, one panel per process.

use std::path::Path;

use plotters::prelude::*;
use shm_config::counted;

use super::SoakResults;
use super::sample::Sample;
use view::chart::FACE;
use view::sheet::{Area, save};

const PANEL: (u32, u32) = (480, 260);
const COLUMNS: usize = 3;
const LINE: RGBColor = RGBColor(31, 105, 178);

/// Draws `memory.svg` and `memory.png`.
///
/// # Errors
/// If a file cannot be written.
pub fn draw(samples: &[Sample], results: &SoakResults, out: &Path) -> anyhow::Result<()> {
    let lines = results.rows.len().div_ceil(COLUMNS).max(1);
    let size = (PANEL.0 * COLUMNS as u32, 40 + PANEL.1 * lines as u32);
    save(out, "memory", size, |root| panels(samples, results, root))
}

fn panels(samples: &[Sample], results: &SoakResults, root: &Area<'_>) -> anyhow::Result<()> {
    let title = format!(
        "{} in lockstep{}: {}",
        counted(results.ticks, "tick"),
        if results.was_stopped { ", stopped" } else { "" },
        if results.is_flat { "flat" } else { "not flat" }
    );
    let body = root.titled(&title, (FACE, 22))?;
    let lines = results.rows.len().div_ceil(COLUMNS).max(1);
    for (area, row) in body
        .split_evenly((lines, COLUMNS))
        .iter()
        .zip(&results.rows)
    {
        let points: Vec<(f64, f64)> = samples
            .iter()
            .flat_map(|sample| sample.held.iter().map(|held| (sample.tick, held)))
            .filter(|(_, held)| held.name == row.name)
            .map(|(tick, held)| (tick as f64 * 1e-6, held.memory_kb as f64 / 1024.0))
            .collect();
        let top = row.memory_max_kb as f64 / 1024.0 * 1.15 + 0.1;
        let end = results.ticks as f64 * 1e-6;
        let name = format!(
            "{}: {:+.2} kB per million",
            row.name, row.slope_kb_per_million
        );
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .caption(name, (FACE, 16))
            .x_label_area_size(34)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..end, 0.0..top)?;
        chart
            .configure_mesh()
            .x_desc("million ticks")
            .y_desc("MB")
            .axis_desc_style((FACE, 13))
            .label_style((FACE, 12))
            .light_line_style(WHITE)
            .draw()?;
        chart.draw_series(LineSeries::new(points, LINE.stroke_width(2)))?;
    }
    Ok(())
}
