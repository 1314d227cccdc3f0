//! The picture of a distilled judge: how reliable its confidence is, and how often it is
//! right over the share that it passes on.

use maud::{Markup, PreEscaped, html};

use super::figures::{Figures, Point};
use crate::statistics::{Bin, Share};

/// Side of each plot, pixels.
const SIDE: f64 = 300.0;
/// Top of the plots, pixels.
const TOP: f64 = 40.0;
/// Left ends of the two plots, pixels.
const LEFTS: [f64; 2] = [60.0, 470.0];
/// The colours of the net and of the teacher: blue and vermilion of Okabe and Ito, which
/// the colour-blind tell apart.
const COLOURS: [&str; 2] = ["#0072b2", "#d55e00"];
/// Vertical space between two names, pixels.
const NAME: f64 = 18.0;

const STYLE: &str = "text{font:13px sans-serif;fill:#333}.title{font-weight:bold}\
    .grid{stroke:#ddd}.even{stroke:#999;stroke-dasharray:4 4}.line{fill:none;stroke-width:2}\
    .whisker{stroke-width:1.5}";

/// Maps values to pixels.
struct Axes {
    left: f64,
    x: [f64; 2],
    y: [f64; 2],
}

impl Axes {
    fn x(&self, value: f64) -> f64 {
        self.left + SIDE * (value - self.x[0]) / (self.x[1] - self.x[0])
    }

    fn y(&self, value: f64) -> f64 {
        let share = (value - self.y[0]) / (self.y[1] - self.y[0]);
        TOP + SIDE * (1.0 - share.clamp(0.0, 1.0))
    }

    fn frame(&self, title: &str, names: [&str; 2]) -> Markup {
        let at = |ends: [f64; 2], k: usize| ends[0] + (ends[1] - ends[0]) * k as f64 / 5.0;
        html! {
            text class="title" x=(px(self.left)) y="22" { (title) }
            @for k in 0..=5 {
                @let (x, y) = (at(self.x, k), at(self.y, k));
                line class="grid" x1=(px(self.x(x))) x2=(px(self.x(x))) y1=(px(TOP)) y2=(px(TOP + SIDE)) {}
                line class="grid" x1=(px(self.left)) x2=(px(self.left + SIDE)) y1=(px(self.y(y))) y2=(px(self.y(y))) {}
                text x=(px(self.x(x))) y=(px(TOP + SIDE + 18.0)) text-anchor="middle" { (percent(x)) }
                text x=(px(self.left - 6.0)) y=(px(self.y(y) + 4.0)) text-anchor="end" { (percent(y)) }
            }
            text x=(px(self.left + SIDE / 2.0)) y=(px(TOP + SIDE + 38.0)) text-anchor="middle" { (names[0]) }
            text text-anchor="middle"
                transform=(format!("translate({} {}) rotate(-90)", px(self.left - 44.0), px(TOP + SIDE / 2.0))) {
                (names[1])
            }
        }
    }
}

/// The picture as SVG.
pub fn picture(figures: &Figures) -> String {
    let svg = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 800 400" role="img" {
            style { (PreEscaped(STYLE)) }
            rect width="800" height="400" fill="#fff" {}
            (reliability(figures))
            (curve(figures))
        }
    };
    svg.into_string()
}

fn reliability(figures: &Figures) -> Markup {
    let axes = Axes {
        left: LEFTS[0],
        x: [0.5, 1.0],
        y: [0.5, 1.0],
    };
    let sets = [&figures.reliability, &figures.reliability_teacher];
    let names = ["what really happens", "the teacher's answer"];
    html! {
        (axes.frame("Reliability", ["confidence of the net", "answers that are right by"]))
        line class="even" x1=(px(axes.x(0.5))) x2=(px(axes.x(1.0))) y1=(px(axes.y(0.5))) y2=(px(axes.y(1.0))) {}
        @for ((bins, colour), (k, name)) in sets.into_iter().zip(COLOURS).zip(names.iter().enumerate()) {
            (points(&axes, bins, colour, 4.0 * k as f64))
            text x=(px(LEFTS[0] + 12.0)) y=(px(TOP + NAME * (k + 1) as f64)) style=(format!("fill:{colour}")) { (name) }
        }
    }
}

fn points(axes: &Axes, bins: &[Bin], colour: &str, aside: f64) -> Markup {
    let filled = bins.iter().filter(|bin| bin.right.trials > 0);
    html! {
        @for bin in filled {
            @let at = axes.x(bin.confidence_sum / bin.right.trials as f64) + aside;
            @let [low, high] = bin.right.interval();
            line class="whisker" stroke=(colour) x1=(px(at)) x2=(px(at)) y1=(px(axes.y(low))) y2=(px(axes.y(high))) {}
            circle fill=(colour) cx=(px(at)) cy=(px(axes.y(bin.right.mean()))) r="4" {
                title { (format!("{} of {} right", bin.right.hits, bin.right.trials)) }
            }
        }
    }
}

fn curve(figures: &Figures) -> Markup {
    let of = |share: fn(&Point) -> Share| {
        let points = figures.curve.iter();
        let known = points.filter(move |point| share(point).trials > 0);
        known.map(move |point| (point.passed_on, share(point).mean()))
    };
    let [net, teacher] = [of(|point| point.net), of(|point| point.teacher)];
    let lines: [Vec<(f64, f64)>; 2] = [net.collect(), teacher.collect()];
    let least = lines.iter().flatten().map(|(_, share)| *share);
    // A tenth is the least range that shows a difference of a point as one.
    let low = (least.fold(0.9, f64::min) * 10.0).floor() / 10.0;
    let axes = Axes {
        left: LEFTS[1],
        x: [0.0, 0.5],
        y: [low.min(0.9), 1.0],
    };
    let passed_on = figures.passed_on.mean();
    html! {
        (axes.frame("Agreement", ["share passed on", "right by what really happens"]))
        @if (0.0..=0.5).contains(&passed_on) {
            line class="even" x1=(px(axes.x(passed_on))) x2=(px(axes.x(passed_on))) y1=(px(TOP)) y2=(px(TOP + SIDE)) {}
        }
        @for ((line, colour), (k, name)) in lines.iter().zip(COLOURS).zip(["net", "teacher, same questions"].iter().enumerate()) {
            polyline class="line" stroke=(colour) points=(joined(&axes, line)) {}
            text x=(px(LEFTS[1] + SIDE - 8.0)) y=(px(TOP + SIDE - NAME * (2 - k) as f64 + 6.0)) text-anchor="end" style=(format!("fill:{colour}")) { (name) }
        }
    }
}

fn joined(axes: &Axes, line: &[(f64, f64)]) -> String {
    let points = line.iter();
    let points = points.map(|(x, y)| format!("{},{}", px(axes.x(*x)), px(axes.y(*y))));
    points.collect::<Vec<_>>().join(" ")
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

fn px(value: f64) -> String {
    format!("{value:.1}")
}
