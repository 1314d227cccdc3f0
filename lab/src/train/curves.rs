//! Figure 4: learning curves, as SVG and PNG.

use std::path::Path;

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use shm_config::counted;

use super::results::{Results, Seed};
use crate::metric::Metric;
use view::chart::{FACE, FAINT, GRID, INK, legend_entry, write};
use view::sheet::{Area, Sheet, save};

/// Size of the picture, pixels.
const SIZE: (u32, u32) = (1360, 960);
/// Size of the picture of success over queries, pixels.
const QUERIES_SIZE: (u32, u32) = (720, 480);
/// Height of the header with title and explanation, pixels.
const HEAD: u32 = 92;
/// Height of a panel's name and legend, pixels.
const PANEL_HEAD: u32 = 72;
/// Gap between panels, pixels.
const GAP: u32 = 14;
/// Width of a panel's y axis labels, pixels; the legend begins at the axis.
const SCALE: u32 = 62;
/// Maximum number of seeds with numbers at their curves' ends; two curves per seed fill
/// the side of a panel.
const NUMBERED_MAX: usize = 10;
/// Distance between two numbers, pixels.
const NUMBER_PITCH: i32 = 13;
const BLUE: RGBColor = RGBColor(31, 105, 178);
const ORANGE: RGBColor = RGBColor(211, 84, 0);

/// The usual x axis.
const STEPS: &str = "training steps";

/// Number of steps or queries, and a value.
type Point = (f64, f64);

/// One curve of a panel.
struct Curve {
    name: &'static str,
    colour: RGBColor,
    seeds: Vec<(u64, Vec<Point>)>,
}

/// One of the four charts.
struct Panel {
    title: &'static str,
    /// Name of the x axis.
    x: &'static str,
    curves: Vec<Curve>,
    /// Upper end of the y axis; `None` for the maximum of the curves.
    top: Option<f64>,
    /// The paper's final value (Table 1).
    paper: Option<f64>,
}

/// Draws `curves.svg` and `queries.svg`, and the same as PNG, into the folder.
///
/// # Errors
/// If a file cannot be written.
pub fn draw(results: &Results, out: &Path) -> anyhow::Result<()> {
    save(out, "curves", SIZE, |root| picture(results, root))?;
    save(out, "queries", QUERIES_SIZE, |root| {
        draw_panel(&root.margin(GAP / 2, GAP / 2, GAP, GAP), &queries(results))
    })
}

/// Success over the expert's answers that were learnt from: methods that ask at imagined
/// states need more of them in the same steps.
fn queries(results: &Results) -> Panel {
    let over = |metric: Metric, colour| Curve {
        name: metric.name(),
        colour,
        seeds: each(results, |seed| {
            let evaluations = seed.block_evaluations.iter();
            evaluations
                .filter_map(|evaluation| {
                    let block = seed.blocks.iter();
                    let mut block = block.filter(|block| block.steps == evaluation.steps);
                    let queries = block.next()?.expert_queries? as f64;
                    Some((queries, evaluation.of(metric)))
                })
                .collect()
        }),
    };
    Panel {
        title: "Success over the expert's answers that were learnt from",
        x: "expert queries",
        curves: vec![
            over(Metric::Success, BLUE),
            over(Metric::StrictSuccess, ORANGE),
        ],
        top: Some(1.0),
        paper: Some(0.86),
    }
}

fn panels(results: &Results) -> [Panel; 4] {
    let share = |metric: Metric, colour| Curve {
        name: metric.name(),
        colour,
        seeds: each(results, |seed| {
            let block_evaluations = seed.block_evaluations.iter();
            block_evaluations
                .map(|block_evaluation| {
                    (block_evaluation.steps as f64, block_evaluation.of(metric))
                })
                .collect()
        }),
    };
    let interventions = Curve {
        name: "steps not driven by the policy",
        colour: BLUE,
        seeds: each(results, |seed| {
            let blocks = seed.blocks.iter();
            blocks
                .map(|block| (block.steps as f64, block.interventions as f64))
                .collect()
        }),
    };
    let panel = |title, curves, paper| Panel {
        title,
        x: STEPS,
        curves,
        top: Some(1.0),
        paper,
    };
    [
        panel(
            "Success",
            vec![
                share(Metric::Success, BLUE),
                share(Metric::StrictSuccess, ORANGE),
            ],
            Some(0.86),
        ),
        panel(
            "Crash",
            vec![
                share(Metric::CrashLastStep, BLUE),
                share(Metric::Contact, ORANGE),
            ],
            Some(0.0),
        ),
        panel(
            "Other outcomes",
            vec![
                share(Metric::OutOfRoad, BLUE),
                share(Metric::MaxStep, ORANGE),
            ],
            None,
        ),
        Panel {
            title: "Cumulative interventions",
            x: STEPS,
            curves: vec![interventions],
            top: None,
            paper: None,
        },
    ]
}

fn picture(results: &Results, root: &Area<'_>) -> anyhow::Result<()> {
    let (head, body) = root.split_vertically(HEAD);
    let count = results.seeds.len();
    let title = format!("{}, {}", results.algorithm(), counted(count, "seed"));
    let left = (GAP + SCALE) as i32;
    write(&head, &title, (left, 22), (28, INK))?;
    let explained = match count {
        1 => "evaluated without intervention after every block",
        2..=NUMBERED_MAX => {
            "evaluated without intervention after every block; thin: each seed, numbered at its \
             end; thick: mean over all seeds, where all were evaluated"
        }
        _ => {
            "evaluated without intervention after every block; thin: each seed; thick: mean over all \
             seeds, where all were evaluated"
        }
    };
    write(&head, explained, (left, 60), (17, FAINT))?;
    for (area, panel) in body.split_evenly((2, 2)).iter().zip(panels(results)) {
        draw_panel(&area.margin(GAP / 2, GAP / 2, GAP, GAP), &panel)?;
    }
    Ok(())
}

fn draw_panel(area: &Area<'_>, panel: &Panel) -> anyhow::Result<()> {
    let (head, body) = area.split_vertically(PANEL_HEAD);
    write(&head, panel.title, (SCALE as i32, 10), (20, INK))?;
    legend(&head, panel)?;
    let all = || {
        panel
            .curves
            .iter()
            .flat_map(|curve| curve.seeds.iter().flat_map(|(_, points)| points))
    };
    let end = all().map(|point| point.0).fold(1.0, f64::max);
    let highest = all().map(|point| point.1).fold(1.0, f64::max);
    // Keeps a line along the upper end fully visible.
    let top = 1.03 * panel.top.unwrap_or(highest);
    let mut chart = ChartBuilder::on(&body)
        .margin_right(24)
        .x_label_area_size(46)
        .y_label_area_size(SCALE)
        .build_cartesian_2d(0.0..end, 0.0..top)?;
    let is_share = panel.top.is_some();
    chart
        .configure_mesh()
        .x_desc(panel.x)
        .axis_desc_style((FACE, 15).into_font().color(&FAINT))
        .label_style((FACE, 15).into_font().color(&INK))
        .axis_style(FAINT)
        .bold_line_style(GRID)
        .light_line_style(WHITE)
        .x_labels(6)
        .y_labels(6)
        .x_label_formatter(&|x| format!("{x:.0}"))
        .y_label_formatter(&|y| match is_share {
            true => format!("{y:.1}"),
            false => format!("{y:.0}"),
        })
        .draw()?;
    if let Some(paper) = panel.paper {
        let line = DashedLineSeries::new([(0.0, paper), (end, paper)], 6, 5, FAINT.stroke_width(1));
        chart.draw_series(line)?;
    }
    for curve in &panel.curves {
        draw_curve(&mut chart, curve)?;
    }
    number_seeds(&body, chart.plotting_area(), &panel.curves)
}

/// Writes each seed's number at the end of its curves, one below the other where curves
/// end at the same value.
fn number_seeds(
    body: &Area<'_>,
    axes: &DrawingArea<Sheet<'_>, Cartesian2d<RangedCoordf64, RangedCoordf64>>,
    curves: &[Curve],
) -> anyhow::Result<()> {
    let (left, top) = body.get_base_pixel();
    let mut numbers = Vec::new();
    for curve in curves {
        if !(2..=NUMBERED_MAX).contains(&curve.seeds.len()) {
            return Ok(());
        }
        for (seed, points) in &curve.seeds {
            if let Some(end) = points.last() {
                let (x, y) = axes.map_coordinate(end);
                numbers.push((y - top, x - left, seed.to_string(), curve.colour));
            }
        }
    }
    numbers.sort_by_key(|&(y, ..)| y);
    let mut free = i32::MIN;
    for number in &mut numbers {
        number.0 = number.0.max(free);
        free = number.0 + NUMBER_PITCH;
    }
    // Numbers below the axis are moved up again.
    let mut free = axes.get_pixel_range().1.end - top;
    for number in numbers.iter_mut().rev() {
        number.0 = number.0.min(free);
        free = number.0 - NUMBER_PITCH;
    }
    for (y, x, words, colour) in numbers {
        write(body, &words, (x + 5, y - 7), (13, colour))?;
    }
    Ok(())
}

fn draw_curve(
    chart: &mut ChartContext<Sheet<'_>, Cartesian2d<RangedCoordf64, RangedCoordf64>>,
    curve: &Curve,
) -> anyhow::Result<()> {
    if curve.seeds.len() > 1 {
        for (_, seed) in &curve.seeds {
            let faint = curve.colour.mix(0.35).stroke_width(1);
            chart.draw_series(LineSeries::new(seed.iter().copied(), faint))?;
        }
    }
    let mean = mean(&curve.seeds);
    chart.draw_series(LineSeries::new(mean.clone(), curve.colour.stroke_width(3)))?;
    // A single evaluation makes no line.
    if let [only] = mean[..] {
        chart.draw_series([Circle::new(only, 4, curve.colour.filled())])?;
    }
    Ok(())
}

/// Draws the legend above the axes, where it covers no curve.
fn legend(head: &Area<'_>, panel: &Panel) -> anyhow::Result<()> {
    let (mut x, y) = (SCALE as i32, 50);
    let mut entries: Vec<(String, ShapeStyle)> = panel
        .curves
        .iter()
        .map(|curve| (curve.name.into(), curve.colour.stroke_width(3)))
        .collect();
    if let Some(paper) = panel.paper {
        entries.push((
            format!("paper, final value: {paper:.2}"),
            FAINT.stroke_width(1),
        ));
    }
    for (name, style) in entries {
        x = legend_entry(head, &name, style, (x, y))?;
    }
    Ok(())
}

fn each(results: &Results, of: impl Fn(&Seed) -> Vec<Point>) -> Vec<(u64, Vec<Point>)> {
    let seeds = results.seeds.iter().map(|seed| (seed.seed, of(seed)));
    seeds.filter(|(_, points)| !points.is_empty()).collect()
}

/// The mean over the seeds at the steps at which all of them were evaluated.
fn mean(seeds: &[(u64, Vec<Point>)]) -> Vec<Point> {
    let Some(((_, first), others)) = seeds.split_first() else {
        return Vec::new();
    };
    let at = |&(steps, value): &Point| {
        let values = others.iter().map(|(_, seed)| {
            let place = seed.binary_search_by(|point| point.0.total_cmp(&steps));
            Some(seed[place.ok()?].1)
        });
        let others: Option<Vec<f64>> = values.collect();
        let sum = value + others?.iter().sum::<f64>();
        Some((steps, sum / seeds.len() as f64))
    };
    first.iter().filter_map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::mean;

    #[test]
    fn the_mean_is_of_all_seeds_or_not_there() {
        let long = (0, vec![(200.0, 0.0), (400.0, 0.5), (600.0, 1.0)]);
        let gap = (1, vec![(200.0, 1.0), (600.0, 0.0)]);
        assert_eq!(mean(&[long.clone(), gap]), [(200.0, 0.5), (600.0, 0.5)]);
        assert_eq!(mean(std::slice::from_ref(&long)), long.1);
        assert_eq!(mean(&[]), []);
    }
}
