//! `sweep`: trains policies under a judge with label noise, abstention or delay and
//! measures the effect on the policy and on the training drives.

mod picture;
mod shards;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use serde::Serialize;
use shm_config::config::{Algorithm, Simulator};
use shm_config::counted;
use supervisor::cli::parsers::whole;

use crate::report::{Machine, table};
use crate::shard::merge::is_sharded;
use crate::shard::{Shard, holds_shards};
use crate::train::arguments::{ExpertChoice, Train, algorithm};
use crate::train::experiment::Experiment;
use crate::train::results::Results;
use crate::train::table::{INTERVALS, cell};
use crate::train::train;
use stack::Clock;
use supervisor::subcommand::{Configuration, Output, Subcommand, say, write_json_option};

/// Train under a judge with one defect at a time: label noise, abstention, delay.
#[derive(Debug, Args)]
#[command(
    after_help = "Each row is a training (./vlaps train) with faulty_judge.noise, \
        faulty_judge.abstention or faulty_judge.delay_s set; all rows are compared with one training \
        without a defect. Results are kept in --out: the same command continues a stopped sweep. To \
        combine sweeps of other seeds, move their seed-N folders into one sweep's folders and run \
        --report.\n\n\
        --shard I/N does the I-th of N parts of the trainings of all rows, on any machine. The \
        same command continues after Ctrl-C or a kill; a training that was interrupted begins \
        again. --report merges the parts in --out and says which are missing (exit code 1).\n\n\
        Examples:\n  \
        ./vlaps sweep --seeds 5\n  \
        ./vlaps sweep --algorithm pvp --steps 20000 --seeds 3 --out runs/sweep-pvp\n  \
        ./vlaps sweep --seeds 8 --shard 3/8 --out runs/sweep-8\n  \
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
    /// Do part I of N of all trainings, such as 3/8; --out may be shared by machines, or be
    /// copied together.
    #[arg(long, value_name = "I/N", requires = "out", conflicts_with = "json")]
    pub shard: Option<Shard>,
    /// Do not train: print and draw the results in the folder.
    #[arg(long, conflicts_with_all = ["shard", "algorithm", "steps", "seed", "seeds", "final_episodes",
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
        if let Some(shard) = self.shard {
            shards::drive(self, shard, clock)?;
            return Ok(ExitCode::SUCCESS);
        }
        if is_sharded(&self.out)? {
            return match self.report {
                true => shards::report(self),
                false => Err(holds_shards(&self.out)),
            };
        }
        if !self.report {
            for flawed in rows() {
                drive(self, flawed, clock)?;
            }
        }
        let swept = swept(&self.out)?.with_context(|| {
            let out = self.out.display();
            format!("{out}: contains no finished training of a sweep; check --out")
        })?;
        tell(&swept, &self.out)?;
        write_json_option(&self.json, &swept)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// The rows: the training without a defect first.
fn rows() -> impl Iterator<Item = Option<(Flaw, f64)>> {
    let flawed = SWEPT
        .iter()
        .flat_map(|&(flaw, values)| values.iter().map(move |&value| Some((flaw, value))));
    std::iter::once(None).chain(flawed)
}

/// All finished trainings of a sweep; `None` without one.
fn swept(out: &Path) -> anyhow::Result<Option<Swept>> {
    let mut common = None;
    let mut found = Vec::new();
    for flawed in rows() {
        let out = out.join(name(flawed));
        let Some(experiment) = Experiment::read(&out)? else {
            continue;
        };
        let row = read(&Results::read(&out)?, flawed)?;
        if !row.trainings.is_empty() {
            found.push(row);
            common.get_or_insert(experiment);
        }
    }
    common
        .map(|experiment| of_rows(found, &experiment))
        .transpose()
}

fn of_rows(rows: Vec<Row>, experiment: &Experiment) -> anyhow::Result<Swept> {
    Ok(Swept {
        rows,
        algorithm: experiment.algorithm.word().into(),
        steps: experiment.steps,
        episodes: experiment.final_episodes,
        conditions: Machine::here()?,
    })
}

/// Draws and prints.
fn tell(swept: &Swept, out: &Path) -> anyhow::Result<()> {
    let plot = out.join("sweep.svg");
    picture::draw(swept, &plot).with_context(|| plot.display().to_string())?;
    print(&swept.rows);
    say(format_args!(
        "{}, {}, {} each; {}; plot: {}\n{INTERVALS}",
        swept.algorithm,
        counted(swept.steps, "step"),
        counted(swept.episodes, "episode"),
        swept.conditions,
        plot.display()
    ));
    Ok(())
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
fn drive(arguments: &Sweep, flawed: Option<(Flaw, f64)>, clock: Clock) -> anyhow::Result<()> {
    let resume = Experiment::read(&arguments.out.join(name(flawed)))?.is_some();
    train(&arguments.of_row(flawed, resume), clock)
}

impl Sweep {
    /// The trainings of a row.
    fn of_row(&self, flawed: Option<(Flaw, f64)>, resume: bool) -> Train {
        let mut overrides = self.overrides.clone();
        if let Some((flaw, value)) = flawed {
            overrides.push(format!("{}={value:?}", flaw.key()));
        }
        Train {
            algorithm: Some(self.algorithm),
            steps: Some(self.steps),
            // Only the last policy is evaluated on many episodes; the earlier ones only
            // contribute to the learning curve.
            eval_episodes: Some(10),
            final_episodes: Some(self.final_episodes),
            seed: Some(self.seed),
            seeds: Some(self.seeds),
            expert: Some(ExpertChoice::Mpc),
            world: Some(Simulator::BuiltIn),
            actors: None,
            actors_at: None,
            actors_run: None,
            out: Some(self.out.join(name(flawed))),
            resume,
            held_back: false,
            shard: None,
            report: false,
            configuration: Configuration {
                config: None,
                vehicle: None,
                overrides,
            },
            json: None,
        }
    }
}

/// Reads the finished trainings of a row.
fn read(results: &Results, flawed: Option<(Flaw, f64)>) -> anyhow::Result<Row> {
    let mut trainings = Vec::new();
    for seed in &results.seeds {
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

#[cfg(test)]
mod tests {
    use super::{Flaw, name};

    #[test]
    fn each_row_has_its_own_folder() {
        assert_eq!(name(None), "flawless");
        assert_eq!(name(Some((Flaw::Noise, 0.1))), "noise-0.1");
        assert_eq!(name(Some((Flaw::Delay, 30.0))), "delay_s-30");
    }
}
