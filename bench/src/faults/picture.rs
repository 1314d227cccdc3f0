//! Histogram of the time to safety by kind of fault, as SVG and as PNG.

use std::collections::BTreeMap;
use std::path::Path;

use plotters::prelude::*;

use super::results::Row;
use view::chart::{FACE, FAINT, INK};
use view::sheet::{Area, save};

/// Width of the picture and height of a row, pixels.
const WIDTH: u32 = 1000;
const ROW: u32 = 86;
/// Height of the header, pixels.
const HEAD: u32 = 70;
/// Bins of a histogram, and the periods that they cover.
const BARS: usize = 60;
const PERIODS: f64 = 3.0;
const BLUE: RGBColor = RGBColor(31, 105, 178);
const ORANGE: RGBColor = RGBColor(211, 84, 0);

/// Faults of one kind in bins of time to safety; by a command, and by the vehicle's
/// own brake.
type Bars = [[u32; 2]; BARS];

/// Draws `faults.svg` and `faults.png` into the folder.
///
/// # Errors
/// If a file cannot be written.
pub fn draw(rows: &[Row], folder: &Path) -> anyhow::Result<()> {
    let kinds = bars(rows);
    let size = (WIDTH, HEAD + ROW * kinds.len().max(1) as u32);
    save(folder, "faults", size, |root| picture(&kinds, root))
}

/// Times are in periods, so that sets at different rates compare. Longer times are in
/// the last bin.
fn bars(rows: &[Row]) -> BTreeMap<&str, Bars> {
    let mut kinds: BTreeMap<&str, Bars> = BTreeMap::new();
    for row in rows.iter().filter(|row| !row.is_skipped()) {
        let Some(safe_ms) = row.safe_ms else {
            continue;
        };
        let periods = safe_ms * row.rate_hz / 1e3;
        let bar = ((periods / PERIODS * BARS as f64) as usize).min(BARS - 1);
        let by = usize::from(row.by == "vehicle");
        kinds.entry(&row.kind).or_insert([[0; 2]; BARS])[bar][by] += 1;
    }
    kinds
}

fn picture(kinds: &BTreeMap<&str, Bars>, root: &Area<'_>) -> anyhow::Result<()> {
    let (head, body) = root.split_vertically(HEAD);
    let text = |size: i32, colour: RGBColor| (FACE, size).into_font().color(&colour);
    let title = "From the fault to safety, periods";
    head.draw_text(title, &text(26, INK), (70, 12))?;
    head.draw_text("by the next safe command", &text(16, BLUE), (70, 46))?;
    let own = "by the vehicle's own brake: no command was fresh enough";
    head.draw_text(own, &text(16, ORANGE), (290, 46))?;
    for (area, (kind, bars)) in body.split_evenly((kinds.len().max(1), 1)).iter().zip(kinds) {
        let highest = bars.iter().map(|bar| bar[0] + bar[1]).max().unwrap_or(1);
        let mut chart = ChartBuilder::on(area)
            .margin_left(6)
            .margin_right(16)
            .margin_top(6)
            .x_label_area_size(20)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..PERIODS, 0.0..f64::from(highest) * 1.05)?;
        chart
            .configure_mesh()
            .disable_mesh()
            .x_labels(7)
            .y_labels(2)
            .x_label_formatter(&|x| format!("{x:.1}"))
            .y_label_formatter(&|y| format!("{y:.0}"))
            .y_desc("faults")
            .axis_desc_style((FACE, 13).into_font().color(&FAINT))
            .label_style((FACE, 13).into_font().color(&INK))
            .axis_style(FAINT)
            .draw()?;
        let width = PERIODS / BARS as f64;
        for (index, [command, own]) in bars.iter().enumerate() {
            let (left, right) = (width * index as f64, width * (index + 1) as f64);
            let (low, high) = (f64::from(*command), f64::from(command + own));
            let stacked = [(0.0, low, BLUE), (low, high, ORANGE)];
            let shown = stacked.into_iter().filter(|(from, to, _)| to > from);
            chart.draw_series(shown.map(|(from, to, colour)| {
                Rectangle::new([(left, from), (right, to)], colour.filled())
            }))?;
        }
        area.draw_text(kind, &text(16, INK), (WIDTH as i32 - 160, 8))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_takes_longer_than_the_scale_is_in_the_last_bar() {
        let row = |safe_ms: f64, by: &str| Row {
            kind: "kill".into(),
            rate_hz: 10.0,
            safe_ms: Some(safe_ms),
            by: by.into(),
            ..Row::default()
        };
        let rows = [
            row(0.0, "command"),
            row(150.0, "vehicle"),
            row(9e9, "brake"),
        ];
        let kinds = bars(&rows);
        let bars = kinds["kill"];
        assert_eq!((bars[0], bars[30], bars[59]), ([1, 0], [0, 1], [1, 0]));
        let folder = tempfile::tempdir().expect("a folder");
        draw(&rows, folder.path()).expect("drawn");
        let svg = std::fs::read_to_string(folder.path().join("faults.svg")).expect("SVG");
        assert!(svg.contains("kill") && svg.contains("faults"));
    }
}
