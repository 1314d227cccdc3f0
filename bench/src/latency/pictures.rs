//! Plots histograms of lateness and response: one panel per rate and load, both scales
//! logarithmic, all samples shown.

use std::path::Path;

use plotters::prelude::*;

use super::buckets::Series;
use super::row::Row;
use view::chart::{FACE, FAINT, GRID, INK, legend_entry, write};
use view::sheet::{Area, save};

/// Size of a panel, pixels.
const PANEL: (u32, u32) = (460, 240);
/// Height of the header, pixels.
const HEAD: u32 = 104;
/// Width of the longest legend entry, pixels.
const ENTRY: u32 = 210;
/// Histogram bins per factor of ten.
const BINS_PER_DECADE: f64 = 12.0;

const BLUE: RGBColor = RGBColor(31, 105, 178);
const ORANGE: RGBColor = RGBColor(211, 84, 0);
const LIGHT_BLUE: RGBColor = RGBColor(140, 190, 235);
const LIGHT_ORANGE: RGBColor = RGBColor(245, 180, 120);
const GREEN: RGBColor = RGBColor(30, 132, 73);

/// One curve of a panel.
struct Line {
    name: &'static str,
    colour: RGBColor,
    of: &'static str,
    measure: &'static str,
}

/// One plot file.
struct Picture {
    file: String,
    title: String,
    lines: Vec<Line>,
}

/// Draws `lateness-PRIORITY` and `response-PRIORITY`, each as SVG and PNG.
///
/// # Errors
/// If a file cannot be written.
pub fn draw(rows: &[Row], series: &[Vec<Series>], out: &Path) -> anyhow::Result<()> {
    for priority in ["real-time", "ordinary"] {
        let of: Vec<(&Row, &[Series])> = rows
            .iter()
            .zip(series)
            .filter(|(row, _)| row.priority == priority)
            .map(|(row, series)| (row, series.as_slice()))
            .collect();
        if of.is_empty() {
            continue;
        }
        for picture in pictures(priority) {
            let size = size(&of);
            save(out, &picture.file, size, |root| paint(root, &picture, &of))?;
        }
    }
    Ok(())
}

fn pictures(priority: &str) -> [Picture; 2] {
    let line = |name, colour, of, measure| Line {
        name,
        colour,
        of,
        measure,
    };
    let late = "release_lateness";
    [
        Picture {
            file: format!("lateness-{priority}"),
            title: format!("Release lateness and wake-up, {priority} priority"),
            lines: vec![
                line("floor: cyclictest", FAINT, "cyclictest", late),
                line("floor: own thread", GREEN, "own floor", late),
                line("planner: late", LIGHT_ORANGE, "planner", late),
                line("controller: late", LIGHT_BLUE, "controller", late),
                line("planner: wake-up", ORANGE, "planner", "wake_up"),
                line("controller: wake-up", BLUE, "controller", "wake_up"),
            ],
        },
        Picture {
            file: format!("response-{priority}"),
            title: format!("Observation to command, {priority} priority"),
            lines: vec![
                line("response", BLUE, "controller", "response"),
                line("tick of the controller", GREEN, "controller", "execution"),
                line("plan", ORANGE, "planner", "execution"),
            ],
        },
    ]
}

/// The columns (rates) and rows (loads) of a plot.
fn grid(of: &[(&Row, &[Series])]) -> (Vec<f64>, Vec<String>) {
    let (mut rates, mut loads) = (Vec::new(), Vec::new());
    for (row, _) in of {
        if !rates.contains(&row.rate_hz) {
            rates.push(row.rate_hz);
        }
        if !loads.contains(&row.beside) {
            loads.push(row.beside.clone());
        }
    }
    (rates, loads)
}

fn size(of: &[(&Row, &[Series])]) -> (u32, u32) {
    let (rates, loads) = grid(of);
    // The title is as wide as two panels.
    let columns = (rates.len() as u32).max(2);
    (PANEL.0 * columns, HEAD + PANEL.1 * loads.len() as u32)
}

fn paint(root: &Area<'_>, picture: &Picture, of: &[(&Row, &[Series])]) -> anyhow::Result<()> {
    let (head, body) = root.split_vertically(HEAD);
    write(&head, &picture.title, (20, 14), (24, INK))?;
    let (columns, _) = root.dim_in_pixel();
    let (mut x, mut y) = (20, 56);
    for line in &picture.lines {
        let is_there = of
            .iter()
            .any(|(_, all)| find(all, line).is_some_and(|series| series.count() > 0));
        if is_there {
            if x as u32 + ENTRY > columns {
                (x, y) = (20, y + 24);
            }
            x = legend_entry(&head, line.name, line.colour, (x, y))?;
        }
    }
    let (rates, loads) = grid(of);
    let span = span(picture, of);
    let across = (columns / PANEL.0) as usize;
    let panels = body.split_evenly((loads.len(), across));
    for (row, series) in of {
        let column = rates.iter().position(|rate| *rate == row.rate_hz);
        let down = loads.iter().position(|load| *load == row.beside);
        if let (Some(column), Some(down)) = (column, down) {
            let title = format!("{} Hz, {}", row.rate_hz, row.beside);
            panel(
                &panels[down * across + column],
                &title,
                (picture, series),
                span,
            )?;
        }
    }
    Ok(())
}

fn find<'a>(all: &'a [Series], line: &Line) -> Option<&'a Series> {
    let mut all = all.iter();
    all.find(|series| series.of == line.of && series.measure == line.measure)
}

/// The common range of all panels, from the shortest to the longest duration, as powers
/// of ten of microseconds: panels can be compared by eye.
fn span(picture: &Picture, of: &[(&Row, &[Series])]) -> (f64, f64) {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (_, all) in of {
        for series in picture.lines.iter().filter_map(|line| find(all, line)) {
            for bucket in &series.buckets {
                low = low.min((bucket.from_ns.max(100) as f64 / 1e3).log10());
                high = high.max((bucket.below_ns.max(100) as f64 / 1e3).log10());
            }
        }
    }
    match low < high {
        true => (low.floor(), high.ceil()),
        false => (0.0, 3.0),
    }
}

/// The outline of a histogram with bins of equal width on a logarithmic scale: (power of
/// ten of microseconds, power of ten of the count). An empty bin has [`NONE`].
fn steps(series: &Series, (low, high): (f64, f64)) -> Vec<(f64, f64)> {
    let count = ((high - low) * BINS_PER_DECADE).round() as usize;
    let mut bins = vec![0_u64; count.max(1)];
    for bucket in &series.buckets {
        // Buckets are narrower than bins, so each counts for the bin of its middle; below
        // one microsecond some bins stay empty.
        let middle_us = (bucket.from_ns + bucket.below_ns) as f64 / 2e3;
        let place = (middle_us.max(0.1).log10() - low) * BINS_PER_DECADE;
        let last = bins.len() - 1;
        bins[(place.max(0.0) as usize).min(last)] += bucket.count;
    }
    let mut corners = Vec::with_capacity(2 * bins.len());
    for (k, &count) in bins.iter().enumerate() {
        let height = (count as f64).max(NONE).log10();
        let from = low + k as f64 / BINS_PER_DECADE;
        corners.push((from, height));
        corners.push((from + 1.0 / BINS_PER_DECADE, height));
    }
    corners
}

/// Height of an empty bin: below a count of one.
const NONE: f64 = 0.5;

fn panel(
    area: &Area<'_>,
    title: &str,
    (picture, all): (&Picture, &[Series]),
    span: (f64, f64),
) -> anyhow::Result<()> {
    let (head, body) = area.split_vertically(26);
    write(&head, title, (66, 6), (16, INK))?;
    let lines: Vec<(Vec<(f64, f64)>, RGBColor)> = picture
        .lines
        .iter()
        .filter_map(|line| Some((steps(find(all, line)?, span), line.colour)))
        .collect();
    let heights = lines.iter().flat_map(|(corners, _)| corners);
    let top = heights.map(|corner| corner.1).fold(1.0, f64::max).ceil();
    let mut chart = ChartBuilder::on(&body)
        .margin_left(6)
        .margin_right(14)
        .margin_bottom(4)
        .x_label_area_size(34)
        .y_label_area_size(60)
        .build_cartesian_2d(span.0..span.1, NONE.log10()..top)?;
    chart
        .configure_mesh()
        .x_desc("us")
        .y_desc("ticks")
        .axis_desc_style((FACE, 13).into_font().color(&FAINT))
        .label_style((FACE, 13).into_font().color(&INK))
        .axis_style(FAINT)
        .bold_line_style(GRID)
        .light_line_style(WHITE)
        .x_labels((span.1 - span.0) as usize + 1)
        .y_labels(top as usize + 2)
        .x_label_formatter(&|x| power(*x))
        .y_label_formatter(&|y| power(*y))
        .draw()?;
    for (corners, colour) in lines {
        chart.draw_series(LineSeries::new(corners, colour.stroke_width(2)))?;
    }
    Ok(())
}

/// Label of an axis tick; empty between powers of ten.
fn power(exponent: f64) -> String {
    if (exponent - exponent.round()).abs() > 1e-6 {
        return String::new();
    }
    match exponent.round() as i32 {
        negative @ ..0 => format!("{}", 10_f64.powi(negative)),
        thousands @ 6.. => format!("{}M", 10_u64.pow(thousands as u32 - 6)),
        thousands @ 3.. => format!("{}k", 10_u64.pow(thousands as u32 - 3)),
        ones => format!("{}", 10_u64.pow(ones as u32)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::latency::buckets::Bucket;

    #[test]
    fn every_tick_is_in_the_picture() {
        let bucket = |from_ns, below_ns, count| Bucket {
            from_ns,
            below_ns,
            count,
        };
        let series = Series {
            of: "controller".into(),
            measure: "release_lateness".into(),
            buckets: vec![
                bucket(0, 64, 2),
                bucket(10_000, 10_100, 100),
                bucket(900_000_000, 901_000_000, 1),
            ],
        };
        let corners = steps(&series, (0.0, 6.0));
        let total: f64 = corners
            .iter()
            .step_by(2)
            .filter(|corner| corner.1 >= 0.0)
            .map(|corner| 10_f64.powf(corner.1))
            .sum();
        assert!((total - 103.0).abs() < 1e-6, "{total}");
        assert_eq!(corners.len(), 2 * 72);
        assert_eq!(power(3.0), "1k");
        assert_eq!(power(2.5), "");
    }
}
