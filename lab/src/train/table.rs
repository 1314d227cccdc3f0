//! Table 1 of the paper beside our results, and the mean over seeds.

use std::fmt::Write;

use comfy_table::Table;
use shm_config::config::load;
use shm_config::counted;

use super::results::{Block, BlockEvaluation, FinalSeeds, Results, Seed, policy_file};
use super::warnings::{BlockWarning, warnings};
use crate::metric::{FOOTNOTE, Metric};
use crate::outcomes::{KNOWN, Outcomes, over_seeds_and_maps};
use crate::report::table;
use crate::statistics::{mean, student_half};

/// Table 1 (Sec. 6): the figures of the paper and of PVP4Real, as the paper reads them from
/// its curves; empty if it does not report a figure.
fn reported(metric: Metric) -> [&'static str; 2] {
    match metric {
        Metric::Success => ["0.86", "~0.90"],
        Metric::CrashLastStep => ["0.00", "~0"],
        Metric::OutOfRoad => ["0.08", "<0.10"],
        Metric::Completion => ["0.935", "~0.95"],
        Metric::MeanLength => ["1010", ""],
        Metric::StrictSuccess | Metric::Contact | Metric::MaxStep | Metric::MeanSpeed => ["", ""],
    }
}

/// Mean over seeds, and half of its 95 % interval for three or more seeds.
pub(crate) fn over_seeds(values: &[f64]) -> (f64, Option<f64>) {
    (mean(values), student_half(values))
}

/// A cell as [`INTERVALS`] explains it, for a figure between 0 and `most`.
pub(crate) fn cell(values: &[f64], digits: usize, most: f64) -> String {
    let (mean, half) = over_seeds(values);
    match (values, half) {
        ([], _) => String::new(),
        ([one, other], _) => format!("{mean:.digits$} ({one:.digits$}, {other:.digits$})"),
        (_, None) => format!("{mean:.digits$}"),
        (_, Some(half)) => {
            let (low, high) = ((mean - half).max(0.0), (mean + half).min(most));
            format!("{mean:.digits$} ({low:.digits$} to {high:.digits$})")
        }
    }
}

/// Explains the brackets behind a mean.
pub(crate) const INTERVALS: &str = "In brackets: the 95 % interval of the mean over seeds (Student), \
    limited to the figure's range; with two seeds, the two values.";

/// A column of our results: its name and its evaluations.
struct Column<'a> {
    name: String,
    of: Vec<(&'a Seed, BlockEvaluation)>,
}

/// The evaluation after the last block within the first fifth of the steps.
fn early(seed: &Seed) -> Option<BlockEvaluation> {
    let end = seed.block_evaluations.last()?.steps / 5;
    let before = seed
        .block_evaluations
        .iter()
        .rev()
        .find(|block_evaluation| block_evaluation.steps <= end);
    before.copied()
}

/// Table 1: the evaluation after the last block, and an early one if there is one.
pub fn blocks(results: &Results) -> Table {
    let columns: Vec<Column> = [
        column(results, early),
        column(results, |seed| seed.block_evaluations.last().copied()),
    ]
    .into_iter()
    .flatten()
    .collect();
    let mut header = vec!["after a block", "paper", "PVP4Real"];
    header.extend(columns.iter().map(|column| column.name.as_str()));
    let mut table = table(&header);
    for metric in Metric::ALL {
        let mut row = vec![metric.name().to_string()];
        row.extend(reported(metric).map(String::from));
        row.extend(columns.iter().map(|column| {
            let values: Vec<f64> = column
                .of
                .iter()
                .map(|(_, block_evaluation)| block_evaluation.of(metric))
                .collect();
            cell(&values, metric.digits(), metric.most())
        }));
        table.add_row(row);
    }
    let interventions: CountOf = |block| Some(block.interventions);
    let queries: CountOf = |block| block.expert_queries;
    for (name, of) in [
        ("interventions, steps", interventions),
        ("expert queries", queries),
    ] {
        let mut row = vec![name.to_string(), String::new(), String::new()];
        row.extend(columns.iter().map(|column| {
            let at = column.of.iter().filter_map(|(seed, block_evaluation)| {
                let block = seed
                    .blocks
                    .iter()
                    .find(|block| block.steps == block_evaluation.steps)?;
                Some(of(block)? as f64)
            });
            match &at.collect::<Vec<_>>()[..] {
                // The files of an earlier version.
                [] => "-".into(),
                counts => cell(counts, 0, f64::INFINITY),
            }
        }));
        table.add_row(row);
    }
    table
}

/// A count at the end of a block; `None` if its file has none.
type CountOf = fn(&Block) -> Option<u64>;

/// One evaluation of each seed that has it; `None` if no seed has it.
fn column(results: &Results, of: impl Fn(&Seed) -> Option<BlockEvaluation>) -> Option<Column<'_>> {
    let seeds = results.seeds.iter();
    let of: Vec<(&Seed, BlockEvaluation)> =
        seeds.filter_map(|seed| Some((seed, of(seed)?))).collect();
    let steps = of
        .iter()
        .map(|(_, block_evaluation)| block_evaluation.steps);
    let (least, most) = (steps.clone().min()?, steps.max()?);
    let mut name = match least == most {
        true => format!("ours, {}", counted(least, "step")),
        false => format!("ours, {least} to {most} steps"),
    };
    if of.len() < results.seeds.len() {
        let _ = write!(
            name,
            " ({} of {})",
            of.len(),
            counted(results.seeds.len(), "seed")
        );
    }
    Some(Column { name, of })
}

/// The last policies on many episodes, mean over seeds; `None` before their evaluation.
pub fn finals(results: &Results, seeds: FinalSeeds) -> Option<Table> {
    let lasts: Vec<_> = results
        .seeds
        .iter()
        .filter_map(|seed| seed.final_on(seeds))
        .collect();
    let first = lasts.first()?;
    let which = match seeds {
        FinalSeeds::Evaluation => "last policy",
        FinalSeeds::HeldBack => "last policy, held-back episodes",
    };
    let name = format!(
        "{which}, {} x {}",
        counted(lasts.len(), "seed"),
        counted(
            first.evaluation["episodes"].as_u64().unwrap_or_default(),
            "episode"
        )
    );
    let header = match lasts.len() {
        1 | 2 => vec![name.as_str(), "ours"],
        _ => vec![name.as_str(), "mean over seeds", "each"],
    };
    let mut table = table(&header);
    for metric in Metric::ALL {
        let digits = metric.digits();
        let values: Vec<f64> = lasts
            .iter()
            .filter_map(|last| {
                let value = &last.evaluation[metric.key()];
                value.as_f64().or_else(|| value["mean"].as_f64())
            })
            .collect();
        let each: Vec<String> = values
            .iter()
            .map(|value| format!("{value:.digits$}"))
            .collect();
        let mut row = vec![
            metric.name().to_string(),
            cell(&values, digits, metric.most()),
        ];
        if lasts.len() > 2 {
            row.push(each.join(" "));
        }
        table.add_row(row);
    }
    Some(table)
}

/// Describes the policy files.
fn policies(results: &Results) -> Option<String> {
    let best = results.best()?;
    let lasts = results.seeds.iter().filter_map(|seed| {
        let steps = seed.blocks.last()?.steps;
        Some(format!("seed-{}/{}", seed.seed, policy_file(steps)))
    });
    Some(format!(
        "policy.onnx is the policy of seed {} after step {}: of all evaluated blocks, the one with \
         the most strict successes; ties are resolved by successes, completion and steps. After the \
         last block: {}.",
        best.seed.seed,
        best.block_evaluation.steps,
        lasts.collect::<Vec<_>>().join(", ")
    ))
}

/// The intervals over seeds and maps: those over seeds are of the maps that were driven.
fn with_maps(results: &Results, seeds: FinalSeeds) -> Option<String> {
    let finals = results.seeds.iter().filter_map(|seed| seed.final_on(seeds));
    let outcomes = finals.map(|last| Outcomes::of(&last.evaluation));
    let outcomes: Vec<Outcomes> = outcomes.collect::<anyhow::Result<_>>().ok()?;
    let figures = KNOWN.map(|metric| {
        let (mean, half) = over_seeds_and_maps(&outcomes, metric)?;
        let (low, high) = ((mean - half).max(0.0), (mean + half).min(1.0));
        Some(format!(
            "{} {mean:.3} ({low:.3} to {high:.3})",
            metric.name()
        ))
    });
    let [Some(success), Some(strict)] = figures else {
        return None;
    };
    Some(format!(
        "With the maps from seed {} on drawn at random, too: {success}, {strict}.",
        seeds.first()
    ))
}

/// Notes that explain the tables.
pub fn notes(results: &Results) -> Vec<String> {
    let mut notes = vec![FOOTNOTE.to_string()];
    if let Some(Column { name, .. }) = column(results, early) {
        notes.push(format!(
            "\"{name}\" is the last block within the first fifth of the training: how fast it \
             learns."
        ));
    }
    if results.seeds.len() > 1 {
        notes.push(INTERVALS.into());
    }
    notes.extend(
        FinalSeeds::ALL
            .iter()
            .filter_map(|seeds| with_maps(results, *seeds)),
    );
    notes.extend(policies(results));
    for seed in &results.seeds {
        if let Some(block) = seed.blocks.last().filter(|block| block.lost > 0) {
            notes.push(format!(
                "seed {}: {} of {} steps were driven while its learner was not running or not waited \
                 for, and were not learnt from.",
                seed.seed, block.lost, block.steps
            ));
        }
        notes.extend(warnings_of(seed));
    }
    notes
}

/// Maximum number of blocks that are listed.
const BLOCKS_SHOWN: usize = 10;

/// The warnings about a training, each with its blocks.
fn warnings_of(seed: &Seed) -> Vec<String> {
    let Ok(config) = load(&seed.config_file()) else {
        return Vec::new();
    };
    let found = warnings(&seed.blocks, &config);
    let of = |warning: BlockWarning| {
        let ends = found.iter().filter(|(_, other)| *other == warning);
        let ends: Vec<String> = ends.map(|(steps, _)| steps.to_string()).collect();
        let more = match ends.len().saturating_sub(BLOCKS_SHOWN) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        (!ends.is_empty()).then(|| {
            format!(
                "seed {}: in {} {} (ending at step {}{more}).",
                seed.seed,
                counted(ends.len(), "block"),
                warning.words(),
                ends[..ends.len().min(BLOCKS_SHOWN)].join(", ")
            )
        })
    };
    BlockWarning::ALL.into_iter().filter_map(of).collect()
}

/// Both tables as Markdown.
pub fn markdown(results: &Results) -> String {
    let mut text = String::new();
    let mut tables = vec![blocks(results)];
    tables.extend(
        FinalSeeds::ALL
            .iter()
            .filter_map(|seeds| finals(results, *seeds)),
    );
    for mut table in tables {
        table.load_style(comfy_table::presets::ASCII_MARKDOWN);
        let _ = writeln!(text, "{table}\n");
    }
    for note in notes(results) {
        let _ = writeln!(text, "{note}\n");
    }
    text.truncate(text.trim_end().len());
    text.push('\n');
    text
}
