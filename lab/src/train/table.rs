//! Table 1 of the paper with ours beside it, and the mean over seeds.

use std::fmt::Write;

use comfy_table::Table;
use shm_config::config::load;
use shm_config::counted;

use super::doubts::{Doubt, doubts};
use super::results::{Exam, Results, Seed, policy_file};
use crate::metric::{FOOTNOTE, Metric};
use crate::report::table;

/// Table 1 (Sec. 6): the paper's figure and PVP4Real's, as the paper reads it from
/// its curves; nothing where it does not report any.
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

/// Two-sided 95 % quantiles of Student's distribution, by degrees of freedom
/// from 2: the one before is 12.7, an interval as wide as all that is possible.
const STUDENT: [f64; 8] = [4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262];

/// Mean over seeds, and half its 95 % interval of three or more.
pub(crate) fn over_seeds(values: &[f64]) -> (f64, Option<f64>) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let spread = values
        .iter()
        .map(|value| (value - mean).powi(2))
        .sum::<f64>();
    let half = (values.len() > 2).then(|| {
        let student = STUDENT.get(values.len() - 3).copied().unwrap_or(1.96);
        student * (spread / (n - 1.0)).sqrt() / n.sqrt()
    });
    (mean, half)
}

/// What [`INTERVALS`] says, of a figure that is at least 0 and at most this.
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

/// What stands in brackets behind a mean.
pub(crate) const INTERVALS: &str = "In brackets: the 95 % interval of the mean over seeds (Student), as far \
    as the figure can go; of two seeds, which make no interval, both.";

/// A column of ours: its name and what it is of.
struct Column<'a> {
    name: String,
    of: Vec<(&'a Seed, Exam)>,
}

/// The evaluation after the last block within a fifth of the steps so far.
fn early(seed: &Seed) -> Option<Exam> {
    let end = seed.exams.last()?.steps / 5;
    let before = seed.exams.iter().rev().find(|exam| exam.steps <= end);
    before.copied()
}

/// Table 1: the evaluation after the last block, and an early one, where there was
/// one.
pub fn blocks(results: &Results) -> Table {
    let columns: Vec<Column> = [
        column(results, early),
        column(results, |seed| seed.exams.last().copied()),
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
            let values: Vec<f64> = column.of.iter().map(|(_, exam)| exam.of(metric)).collect();
            cell(&values, metric.digits(), metric.most())
        }));
        table.add_row(row);
    }
    let mut row = vec![
        "interventions, steps".to_string(),
        String::new(),
        String::new(),
    ];
    row.extend(columns.iter().map(|column| {
        let at = column.of.iter().filter_map(|(seed, exam)| {
            let block = seed.blocks.iter().find(|block| block.steps == exam.steps)?;
            Some(block.interventions as f64)
        });
        cell(&at.collect::<Vec<_>>(), 0, f64::INFINITY)
    }));
    table.add_row(row);
    table
}

/// One evaluation of each seed that has it; none when none has.
fn column(results: &Results, of: impl Fn(&Seed) -> Option<Exam>) -> Option<Column<'_>> {
    let seeds = results.seeds.iter();
    let of: Vec<(&Seed, Exam)> = seeds.filter_map(|seed| Some((seed, of(seed)?))).collect();
    let steps = of.iter().map(|(_, exam)| exam.steps);
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

/// The last policies on many episodes, mean over seeds; none before they are
/// evaluated.
pub fn finals(results: &Results) -> Option<Table> {
    let lasts: Vec<_> = results
        .seeds
        .iter()
        .filter_map(|seed| seed.last.as_ref())
        .collect();
    let first = lasts.first()?;
    let name = format!(
        "last policy, {} x {}",
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

/// Which policies there are to take away.
fn policies(results: &Results) -> Option<String> {
    let best = results.best()?;
    let lasts = results.seeds.iter().filter_map(|seed| {
        let steps = seed.blocks.last()?.steps;
        Some(format!("seed-{}/{}", seed.seed, policy_file(steps)))
    });
    Some(format!(
        "policy.onnx is the policy of seed {} after step {}: of all evaluated blocks the one with \
         the most strict successes, among these with the most successes, then the farthest \
         completion, then the most steps. After the last block: {}.",
        best.seed.seed,
        best.exam.steps,
        lasts.collect::<Vec<_>>().join(", ")
    ))
}

/// What has to be known to read the tables.
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
    notes.extend(policies(results));
    for seed in &results.seeds {
        if let Some(block) = seed.blocks.last().filter(|block| block.lost > 0) {
            notes.push(format!(
                "seed {}: {} of {} steps were driven while its learner was away, and not learnt \
                 from.",
                seed.seed, block.lost, block.steps
            ));
        }
        notes.extend(doubtful(seed));
    }
    notes
}

/// Blocks listed one by one.
const BLOCKS_SHOWN: usize = 10;

/// Each doubt of a training, with the blocks that it is of.
fn doubtful(seed: &Seed) -> Vec<String> {
    let Ok(config) = load(&seed.config_file()) else {
        return Vec::new();
    };
    let found = doubts(&seed.blocks, &config);
    let of = |doubt: Doubt| {
        let ends = found.iter().filter(|(_, other)| *other == doubt);
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
                doubt.words(),
                ends[..ends.len().min(BLOCKS_SHOWN)].join(", ")
            )
        })
    };
    Doubt::ALL.into_iter().filter_map(of).collect()
}

/// Both tables as Markdown.
pub fn markdown(results: &Results) -> String {
    let mut text = String::new();
    let mut tables = vec![blocks(results)];
    tables.extend(finals(results));
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
