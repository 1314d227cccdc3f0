//! `bench sweep`: what a judge that is wrong, silent or late costs the policy
//! that learns from it, and the car meanwhile.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use clap::Args;
use plotters::prelude::*;
use serde::Serialize;
use shm_config::config::Algorithm;
use shm_config::counted;
use supervisor::numbers::whole;

use crate::Clock;
use crate::arguments::{Configuration, WorldChoice};
use crate::report::{Machine, say, table, write_json};
use crate::train::arguments::{ExpertChoice, Train, algorithm};
use crate::train::experiment::Experiment;
use crate::train::results::Results;
use crate::train::train;

/// Train under a judge with one flaw at a time: label noise, abstention, delay
#[derive(Debug, Args)]
#[command(
    after_help = "Each row is a training of its own (./vlaps train) with gate.noise, \
        gate.abstention or gate.delay_s set; all rows share the first, without a flaw. What is \
        done is kept in --out: a sweep that was stopped goes on.\n\n\
        Examples:\n  \
        ./vlaps bench sweep\n  \
        ./vlaps bench sweep --algorithm pvp --steps 20000 --seeds 3 --out runs/sweep-pvp"
)]
pub struct BenchSweep {
    /// How it learns: pvp, ppl, bc, hg-dagger or dagger.
    #[arg(long, value_name = "HOW", default_value = "hg-dagger", value_parser = algorithm)]
    pub algorithm: Algorithm,
    /// Steps of each training.
    #[arg(long, value_name = "N", default_value_t = 6000, value_parser = whole::<u64>(200..=100_000_000))]
    pub steps: u64,
    /// Trainings for each row.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = whole::<u32>(1..=100))]
    pub seeds: u32,
    /// Episodes that the last policy of each is evaluated on.
    #[arg(long, value_name = "N", default_value_t = 500, value_parser = whole::<u64>(1..=1_000_000))]
    pub final_episodes: u64,
    /// Folder of all trainings, table and plot.
    #[arg(long, value_name = "DIR", default_value = "runs/sweep")]
    pub out: PathBuf,
    /// Override any key of the configuration; repeatable.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// One flaw of a judge.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
enum Flaw {
    /// Share of the answers that are turned round.
    Noise,
    /// Share of the answers that are withheld.
    Abstention,
    /// From question to answer, s.
    Delay,
}

impl Flaw {
    fn key(self) -> &'static str {
        match self {
            Self::Noise => "gate.noise",
            Self::Abstention => "gate.abstention",
            Self::Delay => "gate.delay_s",
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Noise => "share of answers turned round",
            Self::Abstention => "share of answers withheld",
            Self::Delay => "answers late by, s",
        }
    }
}

/// What is swept; each begins at 0, the training without a flaw.
const SWEPT: [(Flaw, &[f64]); 3] = [
    (Flaw::Noise, &[0.1, 0.2, 0.3]),
    (Flaw::Abstention, &[0.25, 0.5]),
    (Flaw::Delay, &[1.0, 10.0, 30.0]),
];

/// Trainings with one flaw; means over their seeds.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    flaw: Option<Flaw>,
    value: f64,
    /// Of the last policy, on the evaluation's episodes.
    success: f64,
    strict_success: f64,
    out_of_road: f64,
    /// Of the episodes driven while training: those that touched something or
    /// left the road.
    unsafe_episodes: f64,
    /// Of the steps while training: those the policy drove.
    policy_share: f64,
    /// Of the steps while training: those the judge in the tick vetoed.
    vetoed_share: f64,
    seeds: usize,
}

/// All rows.
#[derive(Debug, Serialize)]
struct Swept<'a> {
    rows: &'a [Row],
    algorithm: &'static str,
    steps: u64,
    conditions: Machine,
}

/// `./vlaps bench sweep`.
///
/// # Errors
/// When a training fails or is stopped.
pub fn bench(arguments: &BenchSweep, clock: Clock) -> anyhow::Result<()> {
    let conditions = Machine::here()?;
    let mut rows = vec![row(arguments, None, clock)?];
    for (flaw, values) in SWEPT {
        for &value in values {
            rows.push(row(arguments, Some((flaw, value)), clock)?);
        }
    }
    let plot = arguments.out.join("sweep.svg");
    draw(&rows, arguments, &plot).with_context(|| plot.display().to_string())?;
    print(&rows);
    let swept = Swept {
        rows: &rows,
        algorithm: arguments.algorithm.word(),
        steps: arguments.steps,
        conditions,
    };
    say(format_args!(
        "{}, {}, {}, {} each; {}; plot: {}",
        swept.algorithm,
        counted(swept.steps, "step"),
        counted(arguments.seeds, "seed"),
        counted(arguments.final_episodes, "episode"),
        swept.conditions,
        plot.display()
    ));
    match &arguments.json {
        Some(path) => write_json(path, &swept),
        None => Ok(()),
    }
}

fn row(arguments: &BenchSweep, flawed: Option<(Flaw, f64)>, clock: Clock) -> anyhow::Result<Row> {
    let name = match flawed {
        None => "flawless".to_string(),
        Some((flaw, value)) => format!("{}-{value}", flaw.key().trim_start_matches("gate.")),
    };
    let out = arguments.out.join(name);
    let mut overrides = arguments.overrides.clone();
    if let Some((flaw, value)) = flawed {
        overrides.push(format!("{}={value:?}", flaw.key()));
    }
    let resume = Experiment::read(&out)?.is_some();
    train(
        &Train {
            algorithm: Some(arguments.algorithm),
            steps: Some(arguments.steps),
            // The last policy is evaluated on many; those before need no more
            // than a curve.
            eval_episodes: Some(10),
            final_episodes: Some(arguments.final_episodes),
            seed: Some(0),
            seeds: Some(arguments.seeds),
            expert: Some(ExpertChoice::Mpc),
            world: Some(WorldChoice::Sim),
            out: Some(out.clone()),
            resume,
            report: false,
            configuration: Configuration {
                config: None,
                overrides,
            },
            json: None,
        },
        clock,
    )?;
    read(&out, flawed)
}

fn read(out: &Path, flawed: Option<(Flaw, f64)>) -> anyhow::Result<Row> {
    let results = Results::read(out)?;
    let mut row = Row {
        flaw: flawed.map(|(flaw, _)| flaw),
        value: flawed.map_or(0.0, |(_, value)| value),
        success: 0.0,
        strict_success: 0.0,
        out_of_road: 0.0,
        unsafe_episodes: 0.0,
        policy_share: 0.0,
        vetoed_share: 0.0,
        seeds: results.seeds.len(),
    };
    let share = 1.0 / results.seeds.len().max(1) as f64;
    for seed in &results.seeds {
        let last = seed
            .last
            .as_ref()
            .context("a training without its last evaluation")?;
        let mean = |key: &str| last.evaluation[key]["mean"].as_f64().unwrap_or(f64::NAN);
        row.success += share * mean("success");
        row.strict_success += share * mean("strict_success");
        row.out_of_road += share * mean("out_of_road");
        let driven = Driven::read(&seed.folder)?;
        row.unsafe_episodes +=
            share * driven.unsafe_episodes as f64 / driven.episodes.max(1) as f64;
        let steps = driven.steps.max(1) as f64;
        row.policy_share += share * driven.policy as f64 / steps;
        row.vetoed_share += share * driven.vetoed as f64 / steps;
    }
    Ok(row)
}

/// What happened while training, over all sets that a training started.
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
            // One that was stopped has not had its chance.
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

fn print(rows: &[Row]) {
    let mut table = table(&[
        "judge",
        "success",
        "strict",
        "out of road",
        "policy drove",
        "vetoed",
        "unsafe training episodes",
    ]);
    for row in rows {
        let judge = match row.flaw {
            None => "without a flaw".into(),
            Some(flaw) => format!("{} {}", flaw.words(), row.value),
        };
        let shares = [
            row.success,
            row.strict_success,
            row.out_of_road,
            row.policy_share,
            row.vetoed_share,
            row.unsafe_episodes,
        ];
        let mut cells = vec![judge];
        cells.extend(shares.map(|share| format!("{share:.3}")));
        table.add_row(cells);
    }
    say(table);
}

const SIZE: (u32, u32) = (1360, 460);
/// Name, colour and height.
type Curve = (&'static str, RGBColor, fn(&Row) -> f64);
const CURVES: [Curve; 3] = [
    (
        "strict success of the last policy",
        RGBColor(31, 105, 178),
        |row| row.strict_success,
    ),
    (
        "unsafe episodes while training",
        RGBColor(211, 84, 0),
        |row| row.unsafe_episodes,
    ),
    (
        "steps the policy drove while training",
        RGBColor(110, 118, 129),
        |row| row.policy_share,
    ),
];

fn draw(rows: &[Row], arguments: &BenchSweep, path: &Path) -> anyhow::Result<()> {
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let title = format!(
        "{}, {} steps: what a flawed judge costs",
        arguments.algorithm.word(),
        arguments.steps
    );
    let body = root.titled(&title, ("sans-serif", 24))?;
    for (area, (flaw, values)) in body.split_evenly((1, 3)).iter().zip(SWEPT) {
        let end = values.last().copied().unwrap_or(1.0);
        let mut chart = ChartBuilder::on(area)
            .margin(14)
            .x_label_area_size(46)
            .y_label_area_size(44)
            .build_cartesian_2d(0.0..1.03 * end, 0.0..1.03)?;
        chart
            .configure_mesh()
            .x_desc(flaw.words())
            .axis_desc_style(("sans-serif", 16))
            .label_style(("sans-serif", 14))
            .light_line_style(WHITE)
            .draw()?;
        for (name, colour, value) in CURVES {
            let of_flaw = rows
                .iter()
                .filter(|row| row.flaw.is_none_or(|other| other == flaw));
            let points: Vec<(f64, f64)> = of_flaw.map(|row| (row.value, value(row))).collect();
            let line = LineSeries::new(points.clone(), colour.stroke_width(2));
            chart
                .draw_series(line)?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour));
            let dots = points
                .into_iter()
                .map(|at| Circle::new(at, 4, colour.filled()));
            chart.draw_series(dots)?;
        }
        chart
            .configure_series_labels()
            .position(SeriesLabelPosition::MiddleLeft)
            .background_style(WHITE.mix(0.8))
            .label_font(("sans-serif", 13))
            .draw()?;
    }
    root.present()?;
    Ok(())
}
