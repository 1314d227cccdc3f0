//! `vlaps-judge distil`.

use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use gate::distilled::{DistilledNet, MEMBERS_MAX, encode};
use indicatif::{ProgressBar, ProgressStyle};
use judge::distil::picture::picture;
use judge::distil::samples::Sample;
use judge::distil::{Cost, Figures, Learn, Samples, Schedule, Split, distil as train};
use judge::statistics::{Share, quantile};
use serde::Serialize;
use shm_config::counted;
use shm_config::file::{Durable, replace};
use shm_config::text::printable_json;

use crate::arguments::share;
use crate::configuration::config;
use crate::print::say;

/// Train a small net on recorded questions, which answers in place of a slow judge.
#[derive(Debug, Args)]
#[command(
    after_help = "The net learns the answers of the recorded judge, is calibrated and gets its \
        threshold from episodes that it has not learned from. Name runs on other seeds with --test: \
        the figures are then those of questions that neither training nor threshold has seen. With \
        gate.foresight = true, or a judge that sees pictures, the records hold what would really \
        follow; without it only the agreement with the teacher is known.\n\n\
        Examples:\n  \
        ./vlaps judge distil runs/a runs/b --out judge.onnx\n  \
        ./vlaps judge distil runs/a --test runs/b --out judge.onnx --picture judge.svg\n  \
        ./vlaps judge distil runs/a --test runs/b --out judge.onnx --noise 0,0.1,0.2,0.3 --seeds 3\n  \
        ./vlaps up --gate distilled --set gate.distilled=judge.onnx --policy policy.onnx"
)]
pub struct DistilArguments {
    /// Folders of runs, or of their records
    #[arg(value_name = "RUN", required = true, num_args = 1..)]
    pub runs: Vec<PathBuf>,
    /// File for the net
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Runs on other seeds, to measure the net with; repeatable
    #[arg(long, value_name = "RUN", num_args = 1..)]
    pub test: Vec<PathBuf>,
    /// What is learned: outcomes, which are the answers corrected where the simulator knows
    /// which path is safer, or the answers alone
    #[arg(long, value_name = "WHAT", default_value = "outcomes", value_parser = learn)]
    pub learn: Learn,
    /// Greatest share of the questions that is passed on for doubt: the threshold keeps it
    /// with 95 % confidence over the maps of the held-out questions
    #[arg(long, value_name = "P", default_value = "0.1", value_parser = share)]
    pub pass_on: f64,
    /// Shares of the answers that are made wrong, one training each; the file holds the
    /// first
    #[arg(long, value_name = "P", default_value = "0", value_delimiter = ',', value_parser = share)]
    pub noise: Vec<f64>,
    /// Nets whose probabilities are averaged
    #[arg(long, value_name = "N", default_value_t = 5,
          value_parser = clap::value_parser!(u32).range(1..=MEMBERS_MAX as i64))]
    pub members: u32,
    /// Most passes over the questions
    #[arg(long, value_name = "N", default_value_t = 60,
          value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub epochs: u32,
    /// Seed of the split and of all draws; the same seed gives the same file
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=1_000_000_000))]
    pub seed: u64,
    /// Number of trainings for each share of wrong answers, with consecutive seeds; the
    /// file holds the first
    #[arg(long, value_name = "N", default_value_t = 1,
          value_parser = clap::value_parser!(u32).range(1..=100))]
    pub seeds: u32,
    /// Also draw reliability, and agreement over the share passed on, into this SVG file
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// Configuration file for prices and gate.audit; default: vlaps.toml of the current
    /// folder if it exists
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override a key of the configuration, such as vlm.price_in_usd=0.15; repeatable
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub overrides: Vec<String>,
    /// Also write the figures to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

fn learn(text: &str) -> Result<Learn, String> {
    match text {
        "answers" => Ok(Learn::Answers),
        "outcomes" => Ok(Learn::Outcomes),
        _ => Err("must be answers or outcomes".into()),
    }
}

/// The object of `--json`.
#[derive(Debug, Serialize)]
struct Report {
    teacher: judge::distil::samples::Teacher,
    learn: Learn,
    learned_questions: usize,
    calibrated_questions: usize,
    tested: &'static str,
    rows: Vec<Row>,
    cost: Cost,
}

/// One training.
#[derive(Debug, Serialize)]
struct Row {
    noise: f64,
    seed: u64,
    temperature: f64,
    threshold: f64,
    figures: Figures,
}

/// Trains, writes the file of the first training, and prints the figures.
///
/// # Errors
/// If the records cannot be read or are too few, those of `--test` have a map or a judge that
/// does not fit, or a file cannot be written.
pub fn distil(arguments: &DistilArguments) -> anyhow::Result<()> {
    let config = config(arguments.config.as_deref(), &arguments.overrides)?;
    let clean = Samples::read(&arguments.runs)?;
    let tests = match arguments.test.as_slice() {
        [] => None,
        folders => Some(Samples::read(folders)?),
    };
    describe(&clean, tests.as_ref());
    if let Some(tests) = &tests {
        tests.check_apart(&clean)?;
    }
    let trainings = arguments.noise.len() * arguments.seeds as usize;
    let passes = trainings as u64 * u64::from(arguments.members) * u64::from(arguments.epochs);
    let bar = ProgressBar::new(passes);
    let style = "{elapsed_precise} {wide_bar} {pos}/{len} passes, {eta} left";
    bar.set_style(ProgressStyle::with_template(style)?);
    let mut rows = Vec::new();
    let mut sizes = None;
    for &noise in &arguments.noise {
        for seed in (0..u64::from(arguments.seeds)).map(|k| arguments.seed + k) {
            let mut samples = clean.clone();
            samples.spoil(noise, seed);
            let split = Split::of(&samples.samples, seed)?;
            let mut net = one(arguments, (&samples, &split), seed, |count| bar.inc(count))?;
            let is_first = rows.is_empty();
            if is_first {
                replace(&arguments.out, &encode(&net), Durable::Yes)
                    .with_context(|| format!("--out {}", arguments.out.display()))?;
            }
            sizes.get_or_insert((split.learn.len(), split.calibrate.len()));
            let measured = measured(&samples, &split, tests.as_ref(), (noise, seed));
            let measured: Vec<&Sample> = measured.iter().collect();
            let figures = Figures::of(&mut net, &measured);
            if let Some(path) = arguments.picture.as_ref().filter(|_| is_first) {
                let text = picture(&figures);
                std::fs::write(path, text)
                    .with_context(|| format!("--picture {}", path.display()))?;
            }
            rows.push(Row {
                noise,
                seed,
                temperature: net.about.temperature,
                threshold: net.about.threshold,
                figures,
            });
        }
    }
    bar.finish_and_clear();
    let passed_on = rows.first().map_or(0.0, |row| row.figures.passed_on.mean());
    let asked = tests.as_ref().unwrap_or(&clean);
    let (learned_questions, calibrated_questions) = sizes.unwrap_or_default();
    let report = Report {
        teacher: clean.teacher.clone(),
        learn: arguments.learn,
        learned_questions,
        calibrated_questions,
        tested: match tests {
            Some(_) => "test",
            None => "calibration",
        },
        cost: Cost::of(&asked.asked, passed_on, &config.vlm, &config.gate),
        rows,
    };
    print(&report);
    say(arguments.out.display());
    if let Some(path) = &arguments.json {
        let text = serde_json::to_string_pretty(&report)?;
        std::fs::write(path, printable_json(&text).as_bytes())
            .with_context(|| format!("--json {}", path.display()))?;
    }
    Ok(())
}

fn one(
    arguments: &DistilArguments,
    (samples, split): (&Samples, &Split),
    seed: u64,
    passed: impl Fn(u64),
) -> anyhow::Result<DistilledNet> {
    let schedule = Schedule {
        learn: arguments.learn,
        members: arguments.members as usize,
        epochs: arguments.epochs as usize,
        seed,
    };
    let commit = std::env::var("VLAPS_COMMIT").unwrap_or_default();
    let how = (&schedule, arguments.pass_on);
    train(samples, split, how, &commit, |count| passed(count as u64))
}

/// The questions that the figures are of: those for the test, whose answers are made
/// wrong as often, or those for calibration.
fn measured(
    samples: &Samples,
    split: &Split,
    tests: Option<&Samples>,
    (noise, seed): (f64, u64),
) -> Vec<Sample> {
    match tests {
        Some(tests) => {
            let mut tests = tests.clone();
            tests.spoil(noise, !seed);
            tests.samples
        }
        None => {
            let held_out = split.calibrate.iter();
            held_out
                .map(|index| samples.samples[*index].clone())
                .collect()
        }
    }
}

fn describe(learned: &Samples, tests: Option<&Samples>) {
    let one = |name: &str, samples: &Samples| {
        let decided = samples
            .samples
            .iter()
            .filter(|sample| sample.safer().is_some());
        let answered = samples
            .samples
            .iter()
            .filter(|sample| sample.answer.is_some());
        say(format_args!(
            "{name}: {}, {}: {} with an answer of {}, {} in which exactly one path ends in an accident; \
             {} without features",
            counted(samples.runs as u64, "run"),
            counted(samples.samples.len() as u64, "question"),
            answered.count(),
            samples.teacher.words(),
            decided.count(),
            samples.unfit
        ));
        for folder in &samples.unconfigured {
            say(format_args!(
                "warning: {}: no config.toml of a run beside the records: the default car is taken, and \
                 episodes are split by their number",
                folder.display()
            ));
        }
    };
    one("to learn from", learned);
    if let Some(tests) = tests {
        one("to test with", tests);
    }
}

fn print(report: &Report) {
    say(format_args!(
        "learned {} from {}; threshold from {}; measured on {} questions ({})",
        report.learn.word(),
        counted(report.learned_questions as u64, "question"),
        counted(report.calibrated_questions as u64, "question"),
        report.rows.first().map_or(0, |row| row.figures.questions),
        match report.tested {
            "test" => "of --test, not seen in training",
            _ => "those for calibration; add --test with runs on other seeds",
        }
    ));
    say(
        "\n wrong  seed  passed on  novel   right: net (of)  teacher there  balanced: net  teacher  \
         teacher alone  together  as teacher  missed: net  teacher  error of confidence",
    );
    for row in &report.rows {
        let Figures {
            passed_on,
            novel,
            net,
            teacher,
            teacher_alone,
            together,
            with_teacher,
            net_balanced,
            teacher_balanced,
            net_missed,
            teacher_missed,
            calibration_error,
            ..
        } = &row.figures;
        say(format_args!(
            "{:>5.0} % {:>5} {:>10} {:>6} {:>9} {:>6} {:>14} {:>14} {:>8} {:>14} {:>9} {:>11} {:>12} {:>8} {:>20}",
            100.0 * row.noise,
            row.seed,
            percent(*passed_on),
            novel,
            percent(*net),
            net.trials,
            percent(*teacher),
            balanced(*net_balanced),
            balanced(*teacher_balanced),
            percent(*teacher_alone),
            percent(*together),
            percent(*with_teacher),
            percent(*net_missed),
            percent(*teacher_missed),
            calibration_error.map_or("-".into(), |error| format!("{error:.3}")),
        ));
    }
    print_means(&report.rows);
    say(
        "right: by what really happens, where exactly one path ends in an accident; balanced: the \
         mean over the expert's and the policy's path being safer; missed: the policy drives although \
         its path alone does; there: the questions that the net answers\n",
    );
    print_cost(&report.cost);
}

/// The means over the seeds of each share of wrong answers.
fn print_means(rows: &[Row]) {
    let mut noises: Vec<f64> = rows.iter().map(|row| row.noise).collect();
    noises.dedup();
    if noises.len() == rows.len() {
        return;
    }
    for noise in noises {
        let of: Vec<&Row> = rows.iter().filter(|row| row.noise == noise).collect();
        let mean = |value: fn(&Figures) -> Share| mean(of.iter().map(|row| value(&row.figures)));
        say(format_args!(
            "{:.0} % wrong, {}: passed on {}, right: net {}, teacher there {}, together {}",
            100.0 * noise,
            counted(of.len() as u64, "seed"),
            mean(|figures| figures.passed_on),
            mean(|figures| figures.net),
            mean(|figures| figures.teacher),
            mean(|figures| figures.together),
        ));
    }
}

/// The mean of these shares, with the least and the greatest. A share without trials says
/// nothing and is left out; `-` when none is left.
fn mean(shares: impl Iterator<Item = Share>) -> String {
    let known = shares.filter(|share| share.trials > 0);
    let values: Vec<f64> = known.map(|share| 100.0 * share.mean()).collect();
    let [Some(low), Some(high)] = [0.0, 1.0].map(|at| quantile(&values, at)) else {
        return "-".into();
    };
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    format!("{mean:.1} % ({low:.1} to {high:.1})")
}

fn balanced(share: Option<f64>) -> String {
    share.map_or("-".into(), |share| format!("{:.1} %", 100.0 * share))
}

fn print_cost(cost: &Cost) {
    let usd = |value: Option<f64>| {
        value.map_or(
            "unknown (neither tokens nor a cost were recorded)".into(),
            |usd| format!("{usd:.4} USD"),
        )
    };
    let seconds =
        |value: Option<f64>| value.map_or("-".into(), |value_s| format!("{value_s:.3} s"));
    say(format_args!(
        "an hour: {:.0} questions; the slow judge alone {}, latency median {}, p99 {}; behind the net \
         {:.0} questions to it, {} (audit of {:.0} % among them)",
        cost.questions_per_hour,
        usd(cost.alone_usd_per_hour),
        seconds(cost.latency_median_s),
        seconds(cost.latency_p99_s),
        cost.behind_questions_per_hour,
        usd(cost.behind_usd_per_hour),
        100.0 * cost.audit,
    ));
}

fn percent(share: Share) -> String {
    match share.trials {
        0 => "-".into(),
        _ => format!("{:.1} %", 100.0 * share.mean()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_leaves_out_what_has_no_trials() {
        let shares = [(1, 4), (0, 0), (3, 4)].map(|(hits, trials)| Share { hits, trials });
        assert_eq!(mean(shares.into_iter()), "50.0 % (25.0 to 75.0)");
        assert_eq!(mean([Share::default(); 2].into_iter()), "-");
    }
}
