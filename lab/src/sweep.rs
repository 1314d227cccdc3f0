//! `sweep`: trains policies under a judge with label noise, abstention or delay and
//! measures the effect on the policy and on the training drives.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use plotters::prelude::*;
use serde::Serialize;
use shm_config::config::{Algorithm, Simulator};
use shm_config::counted;
use supervisor::cli::parsers::whole;

use crate::report::{Machine, table};
use crate::train::arguments::{ExpertChoice, Train, algorithm};
use crate::train::experiment::Experiment;
use crate::train::results::Results;
use crate::train::table::{INTERVALS, cell, over_seeds};
use crate::train::train;
use stack::Clock;
use supervisor::subcommand::{Configuration, Output, Subcommand, say, write_json_option};
use view::chart::FACE;
use view::sheet::{Area, save_svg};

/// Train under a judge with one defect at a time: label noise, abstention, delay.
#[derive(Debug, Args)]
#[command(
    after_help = "Each row is a training (./vlaps train) with faulty_judge.noise, \
        faulty_judge.abstention or faulty_judge.delay_s set; all rows are compared with one training \
        without a defect. Results are kept in --out: the same command continues a stopped sweep. To \
        combine sweeps of other seeds, move their seed-N folders into one sweep's folders and run \
        --report.\n\n\
        Examples:\n  \
        ./vlaps sweep --seeds 5\n  \
        ./vlaps sweep --algorithm pvp --steps 20000 --seeds 3 --out runs/sweep-pvp\n  \
        ./vlaps sweep --out runs/sweep-pvp --report"
)]
pub struct Sweep {
    /// Algorithm: pvp, ppl, bc, hg-dagger or dagger.
    #[arg(long, value_name = "HOW", default_value = "hg-dagger", value_parser = algorithm)]
    pub algorithm: Algorithm,
    /// Steps per training.
    #[arg(long, value_name = "N", default_value_t = 6000, value_parser = whole::<u64>(200..=100_000_000))]
    pub steps: u64,
    /// Seed of the first training of each row.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<u64>(0..=1_000_000_000))]
    pub seed: u64,
    /// Number of trainings per row, with consecutive seeds.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole::<u32>(1..=100))]
    pub seeds: u32,
    /// Number of episodes on which each last policy is evaluated.
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = whole::<u64>(1..=1_000_000))]
    pub final_episodes: u64,
    /// Folder for all trainings, the table and the plot.
    #[arg(long, value_name = "DIR", default_value = "runs/sweep")]
    pub out: PathBuf,
    /// Do not train: print and draw the results in the folder.
    #[arg(long, conflicts_with_all = ["algorithm", "steps", "seed", "seeds", "final_episodes",
          "overrides"])]
    pub report: bool,
    /// Override any key of the configuration; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Also write the rows to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for Sweep {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let conditions = Machine::here()?;
        let flawed = SWEPT
            .iter()
            .flat_map(|&(flaw, values)| values.iter().map(move |&value| Some((flaw, value))));
        let mut rows = Vec::new();
        let mut common = None;
        for flawed in std::iter::once(None).chain(flawed) {
            let out = self.out.join(name(flawed));
            if !self.report {
                drive(self, flawed, &out, clock)?;
            }
            let Some(experiment) = Experiment::read(&out)? else {
                continue;
            };
            let row = read(&out, flawed)?;
            if !row.trainings.is_empty() {
                rows.push(row);
                common.get_or_insert(experiment);
            }
        }
        let experiment = common.with_context(|| {
            let out = self.out.display();
            format!("{out}: contains no finished training of a sweep; check --out")
        })?;
        let swept = Swept {
            rows,
            algorithm: experiment.algorithm.word().into(),
            steps: experiment.steps,
            episodes: experiment.final_episodes,
            conditions,
        };
        let plot = self.out.join("sweep.svg");
        draw(&swept, &plot).with_context(|| plot.display().to_string())?;
        print(&swept.rows);
        say(format_args!(
            "{}, {}, {} each; {}; plot: {}\n{INTERVALS}",
            swept.algorithm,
            counted(swept.steps, "step"),
            counted(swept.episodes, "episode"),
            swept.conditions,
            plot.display()
        ));
        write_json_option(&self.json, &swept)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// A defect of the judge.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Flaw {
    /// Share of answers that are inverted.
    Noise,
    /// Share of answers that are withheld.
    Abstention,
    /// Delay of each answer, s.
    Delay,
}

impl Flaw {
    fn key(self) -> &'static str {
        match self {
            Self::Noise => "faulty_judge.noise",
            Self::Abstention => "faulty_judge.abstention",
            Self::Delay => "faulty_judge.delay_s",
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Noise => "share of answers inverted",
            Self::Abstention => "share of answers withheld",
            Self::Delay => "delay of answers, s",
        }
    }
}

/// The values of each defect; 0 is the training without a defect.
const SWEPT: [(Flaw, &[f64]); 3] = [
    (Flaw::Noise, &[0.1, 0.2, 0.3]),
    (Flaw::Abstention, &[0.25, 0.5]),
    (Flaw::Delay, &[1.0, 10.0, 30.0]),
];

/// The trainings with one value of a defect.
#[derive(Clone, Debug, Serialize)]
struct Row {
    flaw: Option<Flaw>,
    value: f64,
    trainings: Vec<Training>,
}

impl Row {
    /// One figure of each training.
    fn each(&self, of: fn(&Training) -> f64) -> Vec<f64> {
        self.trainings.iter().map(of).collect()
    }
}

/// Results of one training.
#[derive(Clone, Copy, Debug, Serialize)]
struct Training {
    seed: u64,
    /// Share of successes of the last policy on the evaluation's episodes.
    success: f64,
    strict_success: f64,
    out_of_road: f64,
    /// Share of the training episodes with a contact, or in which the car left the road.
    unsafe_episodes: f64,
    /// Share of the training steps that the policy drove.
    policy_share: f64,
    /// Share of the training steps that the safety check vetoed.
    vetoed_share: f64,
}

/// All rows, and the settings of all trainings.
#[derive(Debug, Serialize)]
struct Swept {
    rows: Vec<Row>,
    algorithm: String,
    steps: u64,
    episodes: u64,
    conditions: Machine,
}

/// Name of a row's folder.
fn name(flawed: Option<(Flaw, f64)>) -> String {
    match flawed {
        None => "flawless".to_string(),
        Some((flaw, value)) => {
            format!("{}-{value}", flaw.key().trim_start_matches("faulty_judge."))
        }
    }
}

/// Runs the missing trainings of a row.
fn drive(
    arguments: &Sweep,
    flawed: Option<(Flaw, f64)>,
    out: &Path,
    clock: Clock,
) -> anyhow::Result<()> {
    let mut overrides = arguments.overrides.clone();
    if let Some((flaw, value)) = flawed {
        overrides.push(format!("{}={value:?}", flaw.key()));
    }
    let resume = Experiment::read(out)?.is_some();
    train(
        &Train {
            algorithm: Some(arguments.algorithm),
            steps: Some(arguments.steps),
            // Only the last policy is evaluated on many episodes; the earlier ones only
            // contribute to the learning curve.
            eval_episodes: Some(10),
            final_episodes: Some(arguments.final_episodes),
            seed: Some(arguments.seed),
            seeds: Some(arguments.seeds),
            expert: Some(ExpertChoice::Mpc),
            world: Some(Simulator::BuiltIn),
            out: Some(out.to_path_buf()),
            resume,
            held_back: false,
            report: false,
            configuration: Configuration {
                config: None,
                vehicle: None,
                overrides,
            },
            json: None,
        },
        clock,
    )
}

/// Reads the finished trainings of a row.
fn read(out: &Path, flawed: Option<(Flaw, f64)>) -> anyhow::Result<Row> {
    let mut trainings = Vec::new();
    for seed in &Results::read(out)?.seeds {
        let Some(last) = &seed.last else {
            continue;
        };
        let mean = |key: &str| last.evaluation[key]["mean"].as_f64().unwrap_or(f64::NAN);
        let driven = Driven::read(&seed.folder)?;
        let steps = driven.steps.max(1) as f64;
        trainings.push(Training {
            seed: seed.seed,
            success: mean("success"),
            strict_success: mean("strict_success"),
            out_of_road: mean("out_of_road"),
            unsafe_episodes: driven.unsafe_episodes as f64 / driven.episodes.max(1) as f64,
            policy_share: driven.policy as f64 / steps,
            vetoed_share: driven.vetoed as f64 / steps,
        });
    }
    Ok(Row {
        flaw: flawed.map(|(flaw, _)| flaw),
        value: flawed.map_or(0.0, |(_, value)| value),
        trainings,
    })
}

/// Counts over all runs of a training's process set.
#[derive(Default)]
struct Driven {
    episodes: u64,
    unsafe_episodes: u64,
    steps: u64,
    policy: u64,
    vetoed: u64,
}

impl Driven {
    fn read(folder: &Path) -> anyhow::Result<Self> {
        let mut driven = Self::default();
        for entry in fs::read_dir(folder).with_context(|| folder.display().to_string())? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if name.starts_with("summary-") && name.ends_with(".json") {
                driven.add(&serde_json::from_str(&fs::read_to_string(&path)?)?);
            }
        }
        Ok(driven)
    }

    fn add(&mut self, summary: &serde_json::Value) {
        for episode in summary["episodes"].as_array().into_iter().flatten() {
            // A stopped episode has no outcome.
            let outcome = episode["outcome"].as_str().unwrap_or_default();
            if outcome == "stopped" {
                continue;
            }
            self.episodes += 1;
            let is_untouched_arrival = episode["strict"].as_bool().unwrap_or(false);
            let is_unsafe =
                outcome == "out_of_road" || (outcome == "arrived" && !is_untouched_arrival);
            self.unsafe_episodes += u64::from(is_unsafe);
        }
        let reasons = summary["reasons"].as_object();
        for (driver, reasons) in reasons.into_iter().flatten() {
            for (reason, count) in reasons.as_object().into_iter().flatten() {
                let count = count.as_u64().unwrap_or(0);
                self.steps += count;
                self.policy += count * u64::from(driver == "policy");
                self.vetoed += count * u64::from(reason == "vetoed" || reason == "unsafe");
            }
        }
    }
}

/// A column of the table: name and figure.
type Column = (&'static str, fn(&Training) -> f64);
const COLUMNS: [Column; 6] = [
    ("success", |training| training.success),
    ("strict", |training| training.strict_success),
    ("out of road", |training| training.out_of_road),
    ("policy drove", |training| training.policy_share),
    ("vetoed", |training| training.vetoed_share),
    ("unsafe training episodes", |training| {
        training.unsafe_episodes
    }),
];

fn print(rows: &[Row]) {
    let names = COLUMNS.iter().map(|(name, _)| *name);
    let header: Vec<&str> = ["judge", "seeds"].into_iter().chain(names).collect();
    let mut table = table(&header);
    for row in rows {
        let judge = match row.flaw {
            None => "without a defect".into(),
            Some(flaw) => format!("{} {}", flaw.words(), row.value),
        };
        let mut cells = vec![judge, row.trainings.len().to_string()];
        cells.extend(COLUMNS.map(|(_, of)| cell(&row.each(of), 3, 1.0)));
        table.add_row(cells);
    }
    say(table);
}

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
fn draw(swept: &Swept, path: &Path) -> anyhow::Result<()> {
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

    use super::{CURVES, Flaw, Row, SWEPT, Swept, Training, draw, name};
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

    #[test]
    fn each_row_has_its_own_folder() {
        assert_eq!(name(None), "flawless");
        assert_eq!(name(Some((Flaw::Noise, 0.1))), "noise-0.1");
        assert_eq!(name(Some((Flaw::Delay, 30.0))), "delay_s-30");
    }
}
