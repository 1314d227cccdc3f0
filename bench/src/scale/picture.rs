//! One picture of all costs over their work, on logarithmic axes.

use std::path::Path;

use plotters::prelude::*;
use view::chart::{FACE, GRID, INK};
use view::sheet::{Area, save};

use super::{Measured, ScaleResults};

const PANEL: (u32, u32) = (460, 300);
const COLUMNS: usize = 3;
const LINE: RGBColor = RGBColor(31, 105, 178);
const DOT: RGBColor = RGBColor(211, 84, 0);

/// Draws `scale.svg` and `scale.png`.
///
/// # Errors
/// If a file cannot be written.
pub fn draw(results: &ScaleResults, out: &Path) -> anyhow::Result<()> {
    let lines = results.sweeps.len().div_ceil(COLUMNS).max(1);
    let size = (PANEL.0 * COLUMNS as u32, 40 + PANEL.1 * lines as u32);
    save(out, "scale", size, |root| panels(results, root))
}

fn panels(results: &ScaleResults, root: &Area<'_>) -> anyhow::Result<()> {
    let body = root.titled(
        "Cost over work, both logarithmic; medians and quartiles",
        (FACE, 22),
    )?;
    let lines = results.sweeps.len().div_ceil(COLUMNS).max(1);
    let areas = body.split_evenly((lines, COLUMNS));
    for (area, measured) in areas.iter().zip(&results.sweeps) {
        panel(measured, area)?;
    }
    Ok(())
}

/// The decades that hold all positive values; (1, 10) without any.
fn decades(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let usable = values.filter(|value| *value > 0.0 && value.is_finite());
    let (low, high) = usable.fold((f64::INFINITY, 0.0_f64), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if !low.is_finite() {
        return (1.0, 10.0);
    }
    let low = low.log10().floor();
    let high = high.log10().ceil().max(low + 1.0);
    (10.0_f64.powf(low), 10.0_f64.powf(high))
}

/// Powers of ten alone: the numbers between them overlap.
fn label(value: f64) -> String {
    let exponent = value.log10();
    match (exponent - exponent.round()).abs() < 1e-6 {
        true if exponent > -0.5 => format!("{value:.0}"),
        true => format!("{value:.*}", -exponent.round() as usize),
        false => String::new(),
    }
}

fn panel(measured: &Measured, area: &Area<'_>) -> anyhow::Result<()> {
    let rows = || {
        measured
            .rows
            .iter()
            .filter(|row| row.work > 0.0 && row.median > 0.0)
    };
    let (left, right) = decades(rows().map(|row| row.work));
    let line: Vec<(f64, f64)> = (measured.fit.iter())
        .flat_map(|fit| {
            // From the first row to the last; the library bends what leaves the panel.
            let ends = [rows().next(), rows().next_back()].into_iter().flatten();
            ends.map(|row| (row.work, fit.at(row.work)))
        })
        .collect();
    let costs = rows().flat_map(|row| [row.median, row.quartiles[0], row.quartiles[1]]);
    let (low, high) = decades(costs.chain(line.iter().map(|(_, cost)| *cost)));
    let exponent = measured
        .fit
        .map(|fit| format!(": exponent {:.2}", fit.exponent));
    let title = format!("{}{}", measured.sweep, exponent.unwrap_or_default());
    let mut chart = ChartBuilder::on(area)
        .margin(10)
        .caption(title, (FACE, 17))
        .x_label_area_size(36)
        .y_label_area_size(64)
        .build_cartesian_2d((left..right).log_scale(), (low..high).log_scale())?;
    chart
        .configure_mesh()
        .x_desc(measured.work)
        .y_desc(measured.cost)
        .axis_desc_style((FACE, 13).into_font().color(&INK))
        .label_style((FACE, 12))
        .bold_line_style(GRID)
        .light_line_style(WHITE)
        .x_label_formatter(&|value| label(*value))
        .y_label_formatter(&|value| label(*value))
        .draw()?;
    chart.draw_series(LineSeries::new(line, LINE.stroke_width(2)))?;
    let spans = rows().map(|row| {
        let [low, high] = row.quartiles;
        PathElement::new([(row.work, low), (row.work, high)], DOT.stroke_width(2))
    });
    chart.draw_series(spans)?;
    chart.draw_series(rows().map(|row| Circle::new((row.work, row.median), 3, DOT.filled())))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use lab::report::Machine;

    use super::super::fit::Fit;
    use super::super::rows::{Row, Settings};
    use super::super::sweep::{Cost, Sweep};
    use super::*;

    #[test]
    fn axes_are_whole_decades_with_their_powers_as_labels() {
        assert_eq!(decades([3.0, 0.5].into_iter()), (0.1, 10.0));
        assert_eq!(decades([1.0, f64::NAN, 0.0].into_iter()), (1.0, 10.0));
        assert_eq!(decades(std::iter::empty()), (1.0, 10.0));
        let labels = [0.01, 0.1, 1.0, 2.0, 1000.0].map(label);
        assert_eq!(labels, ["0.01", "0.1", "1", "", "1000"]);
    }

    #[test]
    fn each_cost_has_a_panel_with_its_exponent_and_a_dot_for_each_row() {
        let measured = |sweep: Sweep| {
            let rows: Vec<Row> = [1, 2, 4, 8]
                .map(|value| {
                    let cost = Cost {
                        work: value as f64,
                        turns: vec![3.0 * value as f64],
                        late: None,
                    };
                    Row::new(value, &cost, &Settings::of(1.0))
                })
                .into();
            let points: Vec<_> = rows.iter().map(|row| (row.work, row.median)).collect();
            Measured {
                sweep: sweep.word(),
                work: sweep.work(),
                cost: sweep.cost(),
                fit: Fit::of(&points),
                rows,
            }
        };
        let results = ScaleResults {
            sweeps: vec![measured(Sweep::Beams), measured(Sweep::Sets100)],
            seconds: 1.0,
            left: 0,
            conditions: Machine::here().expect("a machine"),
        };
        let folder = tempfile::tempdir().expect("a folder");
        draw(&results, folder.path()).expect("drawn");
        let drawn = std::fs::read_to_string(folder.path().join("scale.svg")).expect("an SVG");
        for words in [
            "beams: exponent 1.00",
            "sets-100: exponent 1.00",
            "response p99, us",
        ] {
            assert!(drawn.contains(words), "{words}");
        }
        assert_eq!(drawn.matches("<circle").count(), 8);
    }
}
