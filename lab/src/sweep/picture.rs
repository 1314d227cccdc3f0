//! The picture of a sweep.

use std::path::Path;

use plotters::prelude::*;
use shm_config::counted;
use view::chart::FACE;
use view::sheet::{Area, save_svg};

use super::{Row, SWEPT, Swept, Training};
use crate::train::table::over_seeds;

const SIZE: (u32, u32) = (1360, 460);
/// A curve: name, colour and figure.
type Curve = (&'static str, RGBColor, fn(&Training) -> f64);
const CURVES: [Curve; 3] = [
    (
        "strict success of the last policy",
        RGBColor(31, 105, 178),
        |training| training.strict_success,
    ),
    (
        "unsafe episodes while training",
        RGBColor(211, 84, 0),
        |training| training.unsafe_episodes,
    ),
    (
        "steps the policy drove while training",
        RGBColor(110, 118, 129),
        |training| training.policy_share,
    ),
];

/// Draws a curve through the means of the rows, and a small dot for each training.
pub fn draw(swept: &Swept, path: &Path) -> anyhow::Result<()> {
    save_svg(path, SIZE, |root| picture(swept, root))
}

fn picture(swept: &Swept, root: &Area<'_>) -> anyhow::Result<()> {
    let title = format!(
        "{}, {}: effect of the judge's defects (means; a dot for each training)",
        swept.algorithm,
        counted(swept.steps, "step")
    );
    let body = root.titled(&title, (FACE, 24))?;
    for (area, (flaw, values)) in body.split_evenly((1, 3)).iter().zip(SWEPT) {
        let end = values.last().copied().unwrap_or(1.0);
        let mut chart = ChartBuilder::on(area)
            .margin(14)
            .x_label_area_size(46)
            .y_label_area_size(44)
            .build_cartesian_2d(-0.02 * end..1.03 * end, 0.0..1.03)?;
        chart
            .configure_mesh()
            .x_desc(flaw.words())
            .axis_desc_style((FACE, 16))
            .label_style((FACE, 14))
            .light_line_style(WHITE)
            .draw()?;
        for (name, colour, of) in CURVES {
            let of_flaw: Vec<&Row> = swept
                .rows
                .iter()
                .filter(|row| row.flaw.is_none_or(|other| other == flaw))
                .collect();
            let means = of_flaw
                .iter()
                .map(|row| (row.value, over_seeds(&row.each(of)).0));
            let line = LineSeries::new(means, colour.stroke_width(2));
            chart
                .draw_series(line)?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour));
            let each = of_flaw
                .iter()
                .flat_map(|row| row.each(of).into_iter().map(|figure| (row.value, figure)));
            let dots = each.map(|at| Circle::new(at, 3, colour.mix(0.6).filled()));
            chart.draw_series(dots)?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::UpperRight)
            .background_style(WHITE.mix(0.8))
            .label_font((FACE, 13))
            .draw()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::super::Flaw;
    use super::*;
    use crate::report::Machine;

    fn row(flaw: Option<Flaw>, value: f64, seeds: u64) -> Row {
        let training = |seed| Training {
            seed,
            success: 0.9,
            strict_success: 0.8,
            out_of_road: 0.05,
            unsafe_episodes: 0.1,
            policy_share: 0.6,
            vetoed_share: 0.01,
        };
        Row {
            flaw,
            value,
            trainings: (0..seeds).map(training).collect(),
        }
    }

    #[test]
    fn the_plot_has_a_dot_for_each_training() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("sweep.svg");
        let swept = Swept {
            rows: vec![row(None, 0.0, 3), row(Some(Flaw::Noise), 0.1, 2)],
            algorithm: "hg-dagger".into(),
            steps: 6000,
            episodes: 500,
            conditions: Machine::here().expect("a machine"),
        };
        draw(&swept, &path).expect("drawn");
        let drawn = fs::read_to_string(&path).expect("an SVG");
        // The training without a defect is in each chart, that with noise in one.
        let dots = CURVES.len() * (3 * SWEPT.len() + 2);
        assert_eq!(drawn.matches("<circle").count(), dots);
    }
}
