//! Figure 4: learning curves, the same chart as SVG and as PNG.

use std::path::Path;
use std::sync::OnceLock;

use anyhow::{Context, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::register_font;

use super::results::{Exam, Results, Seed};
use super::table::over_seeds;

/// Size of the picture, pixels.
const SIZE: (u32, u32) = (1200, 800);
/// The face that everything is written in; the pictures need no font of the
/// machine.
const FACE: &str = "sans-serif";

/// A point of a curve: steps, mean over seeds, half its 95 % interval.
type Point = (f64, f64, f64);

/// One curve of a panel.
struct Curve {
    name: &'static str,
    colour: RGBColor,
    points: Vec<Point>,
}

/// Draws `curves.svg` and `curves.png` into the folder.
///
/// # Errors
/// When a file cannot be written.
pub fn draw(results: &Results, algorithm: &str, out: &Path) -> anyhow::Result<()> {
    static FONT: OnceLock<bool> = OnceLock::new();
    let known = FONT.get_or_init(|| {
        register_font(FACE, FontStyle::Normal, epaint_default_fonts::UBUNTU_LIGHT).is_ok()
    });
    if !known {
        return Err(anyhow!("the font cannot be read"));
    }
    let svg = out.join("curves.svg");
    let root = SVGBackend::new(&svg, SIZE).into_drawing_area();
    panels(results, algorithm, &root).with_context(|| svg.display().to_string())?;
    let png = out.join("curves.png");
    let root = BitMapBackend::new(&png, SIZE).into_drawing_area();
    panels(results, algorithm, &root).with_context(|| png.display().to_string())
}

fn panels<B>(results: &Results, algorithm: &str, root: &DrawingArea<B, Shift>) -> anyhow::Result<()>
where
    B: DrawingBackend,
    B::ErrorType: 'static,
{
    root.fill(&WHITE)?;
    let count = results.seeds.len();
    let seeds = if count == 1 {
        "1 seed"
    } else {
        &format!("{count} seeds")
    };
    let title = format!("{algorithm}, {seeds}: evaluation without intervention after every block");
    let root = root.titled(&title, (FACE, 22))?;
    let areas = root.split_evenly((2, 2));
    let share = |name, colour, of: fn(&Exam) -> f64| Curve {
        name,
        colour,
        points: exam_points(results, of),
    };
    let blue = RGBColor(31, 119, 180);
    let orange = RGBColor(214, 95, 14);
    let success = [
        share("success", blue, |exam| exam.success),
        share("and nothing touched", orange, |exam| exam.strict_success),
    ];
    let crash = [
        share("touching at the last step", blue, |exam| {
            exam.crash_last_step
        }),
        share("touched at any step", orange, |exam| exam.contact),
    ];
    let out_of_road = [
        share("out of road", blue, |exam| exam.out_of_road),
        share("out of time", orange, |exam| exam.max_step),
    ];
    let interventions = [Curve {
        name: "steps that the policy did not drive",
        colour: blue,
        points: intervention_points(results),
    }];
    panel(&areas[0], "success rate", &success, Some(1.0))?;
    panel(&areas[1], "crash rate", &crash, Some(1.0))?;
    panel(&areas[2], "out-of-road rate", &out_of_road, Some(1.0))?;
    panel(&areas[3], "cumulative interventions", &interventions, None)?;
    root.present()?;
    Ok(())
}

fn panel<B>(
    area: &DrawingArea<B, Shift>,
    title: &str,
    curves: &[Curve],
    top: Option<f64>,
) -> anyhow::Result<()>
where
    B: DrawingBackend,
    B::ErrorType: 'static,
{
    let all = || curves.iter().flat_map(|curve| &curve.points);
    let end = all().map(|point| point.0).fold(1.0, f64::max);
    let highest = all().map(|point| point.1 + point.2).fold(1.0, f64::max);
    let top = top.map_or(1.05 * highest, |top| 1.02 * top);
    let mut chart = ChartBuilder::on(area)
        .caption(title, (FACE, 18))
        .margin(12)
        .x_label_area_size(36)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..end, 0.0..top)?;
    chart
        .configure_mesh()
        .x_desc("training steps")
        .label_style((FACE, 14))
        .light_line_style(WHITE)
        .x_labels(6)
        .x_label_formatter(&|x| format!("{x:.0}"))
        .y_label_formatter(&|y| match top > 2.0 {
            true => format!("{y:.0}"),
            false => format!("{y:.1}"),
        })
        .draw()?;
    for curve in curves {
        let band =
            |sign: f64| move |&(x, mean, half): &Point| (x, (mean + sign * half).clamp(0.0, top));
        let mut outline: Vec<(f64, f64)> = curve.points.iter().map(band(1.0)).collect();
        outline.extend(curve.points.iter().rev().map(band(-1.0)));
        chart.draw_series([Polygon::new(outline, curve.colour.mix(0.18))])?;
        let line = curve.points.iter().map(|&(x, mean, _)| (x, mean));
        let colour = curve.colour;
        chart
            .draw_series(LineSeries::new(line, colour.stroke_width(2)))?
            .label(curve.name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(2)));
    }
    chart
        .configure_series_labels()
        .label_font((FACE, 14))
        .border_style(BLACK.mix(0.3))
        .background_style(WHITE.mix(0.8))
        .position(match top > 2.0 {
            true => SeriesLabelPosition::LowerRight,
            false => SeriesLabelPosition::MiddleRight,
        })
        .draw()?;
    Ok(())
}

fn exam_points(results: &Results, of: fn(&Exam) -> f64) -> Vec<Point> {
    points(results, |seed| {
        seed.exams
            .iter()
            .map(|exam| (exam.steps, of(exam)))
            .collect()
    })
}

fn intervention_points(results: &Results) -> Vec<Point> {
    points(results, |seed| {
        let blocks = seed.blocks.iter();
        blocks
            .map(|block| (block.steps, block.interventions as f64))
            .collect()
    })
}

/// The mean over the seeds that have come so far, where the first one was
/// evaluated.
fn points(results: &Results, of: impl Fn(&Seed) -> Vec<(u64, f64)>) -> Vec<Point> {
    let seeds: Vec<Vec<(u64, f64)>> = results.seeds.iter().map(of).collect();
    let Some(longest) = seeds.iter().max_by_key(|seed| seed.len()) else {
        return Vec::new();
    };
    let at = |steps: u64| {
        let values = seeds.iter().filter_map(|seed| {
            let place = seed.binary_search_by_key(&steps, |point| point.0).ok()?;
            Some(seed[place].1)
        });
        let (mean, half) = over_seeds(&values.collect::<Vec<_>>());
        (steps as f64, mean, half.unwrap_or(0.0))
    };
    longest.iter().map(|&(steps, _)| at(steps)).collect()
}
