//! Table 1 of the paper with ours beside it, and the mean over seeds.

use std::fmt::Write;

use comfy_table::Table;

use super::results::{Exam, Results};
use crate::report::table;

/// One row of Table 1: name, the paper's figure, PVP4Real's as the paper reads it
/// from its curves, and ours.
type Row = (&'static str, &'static str, &'static str, fn(&Exam) -> f64);

/// Table 1 (Sec. 6), and below it what the paper does not report.
const ROWS: [Row; 9] = [
    ("success", "0.86", "~0.90", |exam| exam.success),
    ("strict: and nothing touched", "", "", |exam| {
        exam.strict_success
    }),
    ("crash at the last step", "0.00", "~0", |exam| {
        exam.crash_last_step
    }),
    ("touched at any step", "", "", |exam| exam.contact),
    ("out of road", "0.08", "<0.10", |exam| exam.out_of_road),
    ("max step", "", "", |exam| exam.max_step),
    ("route completion", "0.935", "~0.95", |exam| exam.completion),
    ("length, steps", "1010", "", |exam| exam.mean_length),
    ("speed, m/s", "", "", |exam| exam.mean_speed_mps),
];

/// Two-sided 95 % quantiles of Student's distribution, by degrees of freedom
/// from 1.
const STUDENT: [f64; 9] = [
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262,
];

/// Mean over seeds and half its 95 % interval; none of one seed.
pub fn over_seeds(values: &[f64]) -> (f64, Option<f64>) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let spread = values
        .iter()
        .map(|value| (value - mean).powi(2))
        .sum::<f64>();
    let half = (values.len() > 1).then(|| {
        let student = STUDENT.get(values.len() - 2).copied().unwrap_or(1.96);
        student * (spread / (n - 1.0)).sqrt() / n.sqrt()
    });
    (mean, half)
}

fn cell(values: &[f64], digits: usize) -> String {
    if values.is_empty() {
        return String::new();
    }
    match over_seeds(values) {
        (mean, Some(half)) => format!("{mean:.digits$} ± {half:.digits$}"),
        (mean, None) => format!("{mean:.digits$}"),
    }
}

fn digits(name: &str) -> usize {
    match name {
        "length, steps" => 0,
        "speed, m/s" => 2,
        _ => 3,
    }
}

/// Table 1: the evaluation after the last block, and after the block whose steps
/// are nearest below a fifth of all.
pub fn blocks(results: &Results) -> Table {
    let last = |seed: &super::results::Seed| seed.exams.last().copied();
    let early = |seed: &super::results::Seed| {
        let end = seed.exams.last()?.steps / 5;
        let before = seed.exams.iter().rev().find(|exam| exam.steps <= end);
        before.copied()
    };
    let lasts: Vec<Exam> = results.seeds.iter().filter_map(last).collect();
    let earlies: Vec<Exam> = results.seeds.iter().filter_map(early).collect();
    let name = |exams: &[Exam]| match exams.first() {
        Some(exam) => format!("ours, {} steps", exam.steps),
        None => "ours".into(),
    };
    let header = [
        "after a block",
        "paper",
        "PVP4Real",
        &name(&earlies),
        &name(&lasts),
    ];
    let mut table = table(&header);
    for (row, paper, baseline, of) in ROWS {
        let ours = [&earlies, &lasts].map(|exams: &Vec<Exam>| {
            let values: Vec<f64> = exams.iter().map(of).collect();
            cell(&values, digits(row))
        });
        table.add_row([row, paper, baseline, &ours[0], &ours[1]]);
    }
    let interventions: Vec<f64> = results
        .seeds
        .iter()
        .filter_map(|seed| Some(seed.blocks.last()?.interventions as f64))
        .collect();
    let interventions = cell(&interventions, 0);
    table.add_row(["interventions, steps", "", "", "", &interventions]);
    table
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
        "last policy, {} seeds x {} episodes",
        lasts.len(),
        first.evaluation["episodes"]
    );
    let mut table = table(&[&name, "mean over seeds", "each"]);
    let keys = [
        ("success", 3),
        ("strict_success", 3),
        ("contact", 3),
        ("crash_last_step", 3),
        ("out_of_road", 3),
        ("max_step", 3),
        ("completion", 3),
        ("mean_length", 0),
        ("mean_speed_mps", 2),
    ];
    for (key, digits) in keys {
        let values: Vec<f64> = lasts
            .iter()
            .filter_map(|last| {
                let value = &last.evaluation[key];
                value.as_f64().or_else(|| value["mean"].as_f64())
            })
            .collect();
        let each: Vec<String> = values
            .iter()
            .map(|value| format!("{value:.digits$}"))
            .collect();
        table.add_row([key, &cell(&values, digits), &each.join(" ")]);
    }
    Some(table)
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
    text.push_str("± is half the 95 % interval of the mean over seeds (Student).\n");
    text
}
