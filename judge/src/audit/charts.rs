//! The charts of the page, as SVG with the colours of the page's style.

use maud::{Markup, html};

use super::figures::BINS;
use crate::statistics::{Bin, Share};
use gate::record::{Record, Said};

/// Number of bins of the latency histogram.
const BARS: usize = 28;
/// Positions of the axis ticks within a decade.
const MARKS: [f64; 3] = [1.0, 2.0, 5.0];

/// Shares with their confidence intervals on one axis from 0 to 1, one row each; a line
/// marks one half, which is no bias.
pub fn shares(rows: &[(String, Share)]) -> Markup {
    const LEFT: f64 = 120.0;
    const WIDE: f64 = 330.0;
    let height = 34.0 + 30.0 * rows.len() as f64;
    let x = |share: f64| LEFT + WIDE * share;
    html! {
        svg viewBox=(format!("0 0 560 {height}")) role="img" {
            @for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
                @let class = if tick == 0.5 { "even" } else { "grid" };
                line class=(class) x1=(px(x(tick))) x2=(px(x(tick))) y1="6" y2=(px(height - 22.0)) {}
                text class="tick" x=(px(x(tick))) y=(px(height - 6.0)) text-anchor="middle" {
                    (format!("{:.0} %", tick * 100.0))
                }
            }
            @for (index, (name, share)) in rows.iter().enumerate() {
                @let y = 22.0 + 30.0 * index as f64;
                @let [low, high] = share.interval();
                text x=(px(LEFT - 14.0)) y=(px(y + 5.0)) text-anchor="end" { (name) }
                line class="whisker" x1=(px(x(low))) x2=(px(x(high))) y1=(px(y)) y2=(px(y)) {}
                circle class="dot" cx=(px(x(share.mean()))) cy=(px(y)) r="6" {}
                text class="tick" x=(px(LEFT + WIDE + 18.0)) y=(px(y + 5.0)) {
                    (format!("{} of {}", share.hits, share.trials))
                }
            }
        }
    }
}

/// Share of right replies by stated confidence.
pub fn calibration(bins: &[Bin; BINS]) -> Markup {
    const LEFT: f64 = 56.0;
    const SIDE: f64 = 300.0;
    let x = |value: f64| LEFT + SIDE * value;
    let y = |value: f64| 16.0 + SIDE * (1.0 - value);
    let most = bins.iter().map(|bin| bin.right.trials).max().unwrap_or(0);
    let filled = || {
        let bins = bins.iter().enumerate();
        bins.filter(|(_, bin)| bin.right.trials > 0)
    };
    html! {
        svg viewBox="0 0 420 372" role="img" {
            @for tick in [0.0, 0.25, 0.5, 0.75, 1.0] {
                line class="grid" x1=(px(x(tick))) x2=(px(x(tick))) y1=(px(y(0.0))) y2=(px(y(1.0))) {}
                line class="grid" x1=(px(x(0.0))) x2=(px(x(1.0))) y1=(px(y(tick))) y2=(px(y(tick))) {}
                text class="tick" x=(px(x(tick))) y=(px(y(0.0) + 18.0)) text-anchor="middle" { (tick) }
                text class="tick" x=(px(x(0.0) - 8.0)) y=(px(y(tick) + 4.0)) text-anchor="end" { (tick) }
            }
            line class="even" x1=(px(x(0.0))) x2=(px(x(1.0))) y1=(px(y(0.0))) y2=(px(y(1.0))) {}
            @for (index, bin) in filled() {
                @let high = 60.0 * bin.right.trials as f64 / most.max(1) as f64;
                rect class="faint" x=(px(x(index as f64 / BINS as f64) + 2.0)) y=(px(y(0.0) - high))
                    width=(px(SIDE / BINS as f64 - 4.0)) height=(px(high)) {}
            }
            @for (_, bin) in filled() {
                @let [low, high] = bin.right.interval();
                @let at = x(bin.confidence_sum / bin.right.trials as f64);
                line class="whisker" x1=(px(at)) x2=(px(at)) y1=(px(y(low))) y2=(px(y(high))) {}
                circle class="dot" cx=(px(at)) cy=(px(y(bin.right.mean()))) r="6" {
                    title { (format!("{} of {} right", bin.right.hits, bin.right.trials)) }
                }
            }
            text class="tick" x=(px(x(0.5))) y="366" text-anchor="middle" { "stated confidence" }
            text class="tick" transform=(format!("translate(14 {}) rotate(-90)", px(y(0.5))))
                text-anchor="middle" { "share of right replies" }
        }
    }
}

/// Histogram of the latencies; the axis is logarithmic.
pub fn latencies(latencies_s: &[f64]) -> Markup {
    const LEFT: f64 = 44.0;
    const WIDE: f64 = 700.0;
    const HIGH: f64 = 150.0;
    let shortest_s = latencies_s.iter().copied().fold(f64::INFINITY, f64::min);
    let longest_s = latencies_s.iter().copied().fold(0.0, f64::max);
    // Widen the range by a tenth of a decade on each side, so that equal latencies show as a bar.
    let low = shortest_s.max(1e-4).log10() - 0.1;
    let high = longest_s.max(1e-4).log10() + 0.1;
    let share = |latency_s: f64| (latency_s.max(1e-4).log10() - low) / (high - low);
    let mut bars = [0_usize; BARS];
    for &latency_s in latencies_s {
        let at = (share(latency_s) * BARS as f64) as usize;
        bars[at.min(BARS - 1)] += 1;
    }
    let most = bars.iter().copied().max().unwrap_or(0).max(1);
    let decades = (low.floor() as i32)..=(high.ceil() as i32);
    let marks = decades.flat_map(|decade| MARKS.map(|mark| mark * 10f64.powi(decade)));
    let wide = WIDE / BARS as f64;
    html! {
        svg viewBox="0 0 760 200" role="img" {
            line class="axis" x1=(px(LEFT)) x2=(px(LEFT + WIDE)) y1=(px(HIGH + 10.0)) y2=(px(HIGH + 10.0)) {}
            text class="tick" x=(px(LEFT - 8.0)) y="18" text-anchor="end" { (most) }
            @for (index, &count) in bars.iter().enumerate() {
                @let tall = HIGH * count as f64 / most as f64;
                rect class="bar" x=(px(LEFT + wide * index as f64 + 1.0)) y=(px(HIGH + 10.0 - tall))
                    width=(px(wide - 2.0)) height=(px(tall)) {}
            }
            @for mark in marks.filter(|&mark| (0.0..=1.0).contains(&share(mark))) {
                @let at = LEFT + WIDE * share(mark);
                line class="axis" x1=(px(at)) x2=(px(at)) y1=(px(HIGH + 10.0)) y2=(px(HIGH + 15.0)) {}
                text class="tick" x=(px(at)) y=(px(HIGH + 30.0)) text-anchor="middle" { (seconds(mark)) }
            }
        }
    }
}

/// Every question at its time in the run, one row per answer.
pub fn timeline(records: &[Record]) -> Markup {
    const LEFT: f64 = 84.0;
    const WIDE: f64 = 850.0;
    let instants = || records.iter().map(|record| record.taken_ns);
    let first_ns = instants().min().unwrap_or(0);
    let span_s = (instants().max().unwrap_or(0) - first_ns) as f64 * 1e-9;
    let x = |taken_ns: u64| {
        let since_s = (taken_ns - first_ns) as f64 * 1e-9;
        LEFT + WIDE * since_s / span_s.max(1e-3)
    };
    html! {
        svg viewBox="0 0 960 190" role="img" {
            @for (index, said) in Said::ALL.into_iter().enumerate() {
                @let y = 20.0 + 30.0 * index as f64;
                text class=(said.word()) x=(px(LEFT - 14.0)) y=(px(y + 5.0)) text-anchor="end" {
                    (said.word())
                }
                line class="grid" x1=(px(LEFT)) x2=(px(LEFT + WIDE)) y1=(px(y)) y2=(px(y)) {}
                @for record in records.iter().filter(|record| record.said() == said) {
                    @let at = x(record.taken_ns);
                    a href=(format!("#q{}", record.question)) {
                        line class=(format!("mark {}", said.word()))
                            x1=(px(at)) x2=(px(at)) y1=(px(y - 9.0)) y2=(px(y + 9.0)) {
                            title { (format!("question {}, tick {}", record.question, record.tick)) }
                        }
                    }
                }
            }
            text class="tick" x=(px(LEFT)) y="180" { "0 s" }
            text class="tick" x=(px(LEFT + WIDE)) y="180" text-anchor="end" { (format!("{span_s:.0} s")) }
        }
    }
}

/// A duration in the unit that needs fewest digits.
pub fn seconds(value_s: f64) -> String {
    if value_s < 0.999_5 {
        let value_ms = value_s * 1e3;
        return format!("{} ms", short(value_ms));
    }
    format!("{} s", short(value_s))
}

/// Three significant digits at most.
fn short(value: f64) -> String {
    let digits = match value.abs() {
        value if value >= 100.0 => 0,
        value if value >= 10.0 => 1,
        _ => 2,
    };
    let text = format!("{value:.digits$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').into(),
        false => text,
    }
}

fn px(value: f64) -> String {
    format!("{value:.1}")
}
