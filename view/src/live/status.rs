//! How the processes of a run do, and what its folder tells: the part of the page that
//! changes once a second.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use gate::record::Record;
use gate::record::store::{PICTURES, QUESTIONS};
use serde::Serialize;
use shm_config::config::Config;
use shm_config::file::{Access, open_ours, read_ours};
use shm_config::judged::Judged;
use shm_config::message::{Histogram, Measure};
use shm_config::services::Process;
use shm_config::text::printable_lines;
use supervisor::show::view::View;
use supervisor::telemetry::late::{self, LateRow};
use supervisor::telemetry::tally::Tally;

use super::scene::rounded;

/// Bars of a histogram to each power of ten.
const BARS_PER_DECADE: f64 = 12.0;
/// The measures that are drawn.
const SHOWN: [Measure; 4] = [
    Measure::ReleaseLateness,
    Measure::WakeUp,
    Measure::Execution,
    Measure::Response,
];
/// Bytes at the end of the judge's record in which the last question is looked for.
const QUESTION_BYTES_MAX: u64 = 1 << 18;
/// Longest text of a judge that is shown, characters.
const SAID_MAX: usize = 2_000;
/// Longest learning curve that is read, bytes: 50,000 blocks.
const CURVE_BYTES_MAX: u64 = 8 << 20;
/// Points of a learning curve that are drawn.
const CURVE_POINTS_MAX: usize = 400;
/// The learner's curve in a run's folder.
const CURVE: &str = "learner/blocks.csv";
/// The columns of it that are drawn.
const COLUMNS: [&str; 5] = [
    "steps",
    "actor_loss",
    "imitation_loss",
    "critic_loss",
    "interventions",
];

/// How the processes do.
#[derive(Debug, Serialize)]
pub struct Status {
    /// As `./vlaps status` shows it.
    pub view: View,
    /// The most late ticks, the most late first.
    pub late: Vec<LateRow>,
    /// Durations with values.
    pub histograms: Vec<HistogramView>,
    /// The judge's record; `None` without one.
    pub judge: Option<Judged>,
    /// The judge's last question; `None` without one.
    pub question: Option<Question>,
    /// The learning curve by column; `None` without a learner.
    pub learning: Option<BTreeMap<&'static str, Vec<f64>>>,
    /// Steps that were overwritten before they were read.
    pub lost: u64,
}

/// The durations of one measure of one process.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct HistogramView {
    /// The process.
    pub process: &'static str,
    /// The measure.
    pub measure: &'static str,
    /// Durations counted.
    pub count: u64,
    /// Median, us.
    pub p50_us: f64,
    /// us.
    pub p99_us: f64,
    /// us.
    pub p999_us: f64,
    /// Exact, us.
    pub max_us: f64,
    /// The period of the process, by which its tick is due, us; `None` without a deadline.
    pub deadline_us: Option<f64>,
    /// Lower bound, us, and count of each bar; twelve bars to each power of ten.
    pub bars: Vec<(f64, u64)>,
}

/// A question to the judge.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Question {
    /// Its number in the run.
    pub number: u64,
    /// The tick it is about.
    pub tick: u64,
    /// The judge.
    pub judge: String,
    /// The model.
    pub model: String,
    /// The answer, a word.
    pub answer: String,
    /// Why there is none.
    pub fault: String,
    /// Time from question to answer, s.
    pub latency_s: f64,
    /// US dollars.
    pub cost_usd: f64,
    /// What the model said to the first asking.
    pub said: String,
    /// The prompt of the first asking.
    pub prompt: String,
    /// The names of its pictures.
    pub pictures: Vec<String>,
}

impl Status {
    /// From the sums over a run's messages, and its folder.
    pub fn new(
        config: &Config,
        tally: &Tally,
        (restarts, judge): (&BTreeMap<String, u32>, Option<Judged>),
        folder: &mut RunFolder,
    ) -> Self {
        Self {
            view: View::from_outside(config, tally, restarts),
            late: late::most_late(tally),
            histograms: histograms(config, tally),
            judge,
            question: folder.question(),
            learning: folder.learning(),
            lost: 0,
        }
    }
}

fn us(ns: u64) -> f64 {
    rounded(ns as f64 / 1e3, 1)
}

fn histograms(config: &Config, tally: &Tally) -> Vec<HistogramView> {
    let mut shown = Vec::new();
    for process in Process::ALL {
        let Some(counted) = tally.process(*process) else {
            continue;
        };
        let timing = counted.timing();
        for measure in SHOWN {
            let histogram = timing.of(measure);
            if histogram.count > 0 {
                shown.push(histogram_view(config, (*process, measure), histogram));
            }
        }
    }
    shown
}

fn histogram_view(
    config: &Config,
    (process, measure): (Process, Measure),
    histogram: &Histogram,
) -> HistogramView {
    let mut bars = BTreeMap::<i32, u64>::new();
    for (from_ns, below_ns, count) in histogram.filled() {
        let middle_ns = (from_ns + below_ns) as f64 / 2.0;
        let bar = (middle_ns.log10() * BARS_PER_DECADE).floor() as i32;
        *bars.entry(bar).or_default() += u64::from(count);
    }
    let rate_hz = config
        .rate_hz(process)
        .filter(|_| !config.run.is_lockstep());
    let hdr = histogram.to_hdr();
    let quantile_us = |quantile| us(hdr.value_at_quantile(quantile).min(histogram.max_ns));
    HistogramView {
        process: process.word(),
        measure: measure.word(),
        count: histogram.count,
        p50_us: quantile_us(0.5),
        p99_us: quantile_us(0.99),
        p999_us: quantile_us(0.999),
        max_us: us(histogram.max_ns),
        deadline_us: rate_hz.map(|rate_hz| rounded(1e6 / rate_hz, 1)),
        bars: bars
            .into_iter()
            .map(|(bar, count)| {
                let from_ns = 10_f64.powf(f64::from(bar) / BARS_PER_DECADE);
                (rounded(from_ns / 1e3, 4), count)
            })
            .collect(),
    }
}

/// When a file was last written, and its length.
type Stamp = (SystemTime, u64);

/// The folder of a run's files. A file is read again only after it has changed.
#[derive(Debug, Default)]
pub struct RunFolder {
    path: PathBuf,
    question: Option<(Stamp, Option<Question>)>,
    learning: Option<(Stamp, BTreeMap<&'static str, Vec<f64>>)>,
}

impl RunFolder {
    /// A run's folder.
    pub fn new(path: &Path) -> Self {
        Self {
            path: path.into(),
            ..Self::default()
        }
    }

    /// The folder of the judge's pictures.
    pub fn pictures(&self) -> PathBuf {
        self.path.join("judge").join(PICTURES)
    }

    fn question(&mut self) -> Option<Question> {
        let path = self.path.join("judge").join(QUESTIONS);
        let stamp = stamp(&path)?;
        if self
            .question
            .as_ref()
            .is_none_or(|(last, _)| *last != stamp)
        {
            let question = open_ours(&path, Access::Read).ok().and_then(last_question);
            self.question = Some((stamp, question));
        }
        self.question.as_ref()?.1.clone()
    }

    fn learning(&mut self) -> Option<BTreeMap<&'static str, Vec<f64>>> {
        let path = self.path.join(CURVE);
        let stamp = stamp(&path)?;
        if self
            .learning
            .as_ref()
            .is_none_or(|(last, _)| *last != stamp)
        {
            let text = read_ours(&path, CURVE_BYTES_MAX).ok()?;
            self.learning = Some((stamp, curve(&String::from_utf8_lossy(&text))));
        }
        self.learning.as_ref().map(|(_, curve)| curve.clone())
    }
}

fn stamp(path: &Path) -> Option<Stamp> {
    let metadata = path.metadata().ok()?;
    Some((metadata.modified().ok()?, metadata.len()))
}

/// The question on the last whole line of the judge's record.
fn last_question(mut file: File) -> Option<Question> {
    let length = file.metadata().ok()?.len();
    let from = length.saturating_sub(QUESTION_BYTES_MAX);
    file.seek(SeekFrom::Start(from)).ok()?;
    let mut bytes = Vec::new();
    file.take(QUESTION_BYTES_MAX).read_to_end(&mut bytes).ok()?;
    let whole = bytes.iter().rposition(|byte| *byte == b'\n')?;
    let line = bytes[..whole].rsplit(|byte| *byte == b'\n').next()?;
    question(&serde_json::from_slice(line).ok()?)
}

/// The last question at or before a tick in a judge's whole record; lines that are none
/// are passed over.
pub fn question_at(lines: &[u8], tick: u64) -> Option<Question> {
    let lines = lines.rsplit(|byte| *byte == b'\n');
    let mut records = lines.filter_map(|line| serde_json::from_slice::<Record>(line).ok());
    let last = records.find(|record| record.tick <= tick)?;
    question(&last)
}

/// What the page shows of a record.
pub fn question(record: &Record) -> Option<Question> {
    let shown = |text: &str| -> String {
        let text = printable_lines(text);
        text.chars().take(SAID_MAX).collect()
    };
    let first = record.askings.first();
    let names = record.askings.iter().filter_map(|asking| {
        let name = Path::new(&asking.picture).file_name()?.to_str()?;
        is_picture(name).then(|| name.to_string())
    });
    let answer = record
        .preference
        .map_or("no answer", |preference| preference.word());
    Some(Question {
        number: record.question,
        tick: record.tick,
        judge: shown(&record.judge),
        model: shown(&record.model),
        answer: answer.into(),
        fault: shown(&record.fault),
        latency_s: rounded(record.latency_s, 3),
        cost_usd: record.cost_usd,
        said: first.map(|asking| shown(&asking.said)).unwrap_or_default(),
        prompt: first.map(|asking| shown(&asking.user)).unwrap_or_default(),
        pictures: names.collect(),
    })
}

/// Whether this is the name of a judge's picture, as the gate gives it: `000123-a.png`.
pub fn is_picture(name: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '-';
    match name.split_once('.') {
        Some((stem, "png" | "jpg" | "jpeg")) => {
            !stem.is_empty() && stem.len() <= 32 && stem.chars().all(plain)
        }
        _ => false,
    }
}

/// The columns of the learner's curve, thinned out.
fn curve(text: &str) -> BTreeMap<&'static str, Vec<f64>> {
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let rows: Vec<Vec<f64>> = lines
        .filter_map(|line| {
            let row: Result<Vec<f64>, _> = line.split(',').map(str::parse).collect();
            row.ok().filter(|row| row.len() == header.len())
        })
        .collect();
    let stride = rows.len().div_ceil(CURVE_POINTS_MAX).max(1);
    let column = |name: &'static str| {
        let at = header.iter().position(|title| *title == name)?;
        // The last row stays at every stride.
        let kept = rows.iter().rev().step_by(stride).map(|row| row[at]);
        let mut values: Vec<f64> = kept.collect();
        values.reverse();
        Some((name, values))
    };
    COLUMNS.into_iter().filter_map(column).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_has_a_plain_name() {
        for name in ["000123-a.png", "000001-b.jpg", "7.jpeg"] {
            assert!(is_picture(name), "{name}");
        }
        for name in [
            "",
            ".png",
            "../judged.png",
            "a/b.png",
            "a.png.txt",
            "a.svg",
            "a\0.png",
            "\u{202e}.png",
        ] {
            assert!(!is_picture(name), "{name:?}");
        }
    }

    #[test]
    fn a_curve_is_thinned_keeps_its_end_and_skips_a_torn_line() {
        let mut text = String::from("steps,actor_loss\n");
        for k in 0..1_000 {
            text += &format!("{k},{}\n", 0.5 * f64::from(k));
        }
        text += "1000,3";
        let columns = curve(&(text + "\n1001"));
        let steps = &columns["steps"];
        assert!(steps.len() <= CURVE_POINTS_MAX && steps.len() > 300);
        assert_eq!(steps.last(), Some(&1000.0));
        assert_eq!(columns["actor_loss"].len(), steps.len());
        assert!(!columns.contains_key("critic_loss"));
        assert!(curve("").values().all(Vec::is_empty));
    }

    #[test]
    fn a_histogram_counts_each_duration_and_knows_its_deadline() {
        let mut histogram = Histogram::default();
        for ns in [900, 15_000, 16_000, 2_000_000, 40_000_000] {
            histogram.record(ns);
        }
        let config = Config::default();
        let of = (Process::Controller, Measure::Response);
        let view = histogram_view(&config, of, &histogram);
        let counted: u64 = view.bars.iter().map(|(_, count)| count).sum();
        assert_eq!((counted, view.count), (5, 5));
        assert_eq!(view.deadline_us, Some(100_000.0));
        assert_eq!(view.max_us, 40_000.0);
    }
}
