//! The whole page: key figures, agreement, bias, calibration and latency.

use std::collections::BTreeSet;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use shm_config::counted;
use shm_config::judged::of_these_similar;

use super::charts::{self, seconds};
use super::figures::{Agreement, Figures};
use super::{Pictures, questions};
use crate::statistics::Share;
use gate::record::Said;
use gate::record::store::Records;

const STYLE: &str = include_str!("page.css");
/// No scripts, no connections, and only embedded pictures.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'";

pub fn page(records: &Records, figures: &Figures, pictures: &Pictures) -> Markup {
    let questions = &records.questions;
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { "The judge's record" }
                style { (PreEscaped(STYLE)) }
            }
            body { main {
                (head(records, figures))
                (tiles(figures))
                (agreement(figures))
                div class="two" { (slots(figures)) (calibration(figures)) }
                (times(records, figures))
                h2 { "Questions" }
                p class="note" {
                    "Each with the picture and the prompt, the reply, the simulator's prediction, \
                     and the next 3 s of the drive."
                }
                @for record in questions { (questions::question(record, pictures)) }
            } }
        }
    }
}

fn head(records: &Records, figures: &Figures) -> Markup {
    // A question that the end of the run cancelled was not asked.
    let mut asked = records
        .questions
        .iter()
        .filter(|record| !record.preset.is_empty());
    let first = asked.next();
    let model = first.map_or("", |record| &record.model);
    let preset = first.map_or("", |record| &record.preset);
    let askings = records.questions.iter().flat_map(|record| &record.askings);
    let served: BTreeSet<_> = askings
        .filter(|asking| !asking.served.is_empty())
        .map(|asking| asking.served.as_str())
        .collect();
    let served: Vec<_> = served.into_iter().collect();
    let mixed = asked.any(|record| record.model != model || record.preset != preset);
    html! {
        h1 { "The judge's record" }
        p class="lead" {
            (records.folder.display().to_string()) " · model asked for " b { (model) }
            @match served.as_slice() {
                [] => { " (the server named none)" }
                names => { ", served " b { (names.join(", ")) } }
            }
            " · prompt " b { (preset) }
            @if mixed { " (and others: the questions use different prompts)" }
            " · " (counted(figures.questions as u64, "question"))
            ", " (counted(figures.requests, "request"))
            @if records.is_torn { " · the last line is incomplete and left out" }
        }
    }
}

fn tiles(figures: &Figures) -> Markup {
    let answered = figures.expert + figures.policy;
    let latency = |value: Option<f64>| value.map_or("–".into(), seconds);
    let agreement = &figures.agreement;
    let right = agreement.of_preferences();
    let tiles = [
        (figures.questions.to_string(), "questions".into()),
        (
            answered.to_string(),
            format!(
                "answered: expert {}, policy {}{}",
                figures.expert,
                figures.policy,
                of_these_similar(figures.similar as u64)
            ),
        ),
        (
            figures.abstained.to_string(),
            "abstained: the replies disagree".into(),
        ),
        (figures.failed.to_string(), faults(figures)),
        (
            percent(right),
            format!(
                "right: {} of {} preferences, in {} that the simulator can check",
                right.hits,
                right.trials,
                counted(agreement.of_all().trials as u64, "question")
            ),
        ),
        (latency(figures.latency_median_s), "median latency".into()),
        (
            latency(figures.latency_p99_s),
            "99 % of latencies below".into(),
        ),
        (
            format!("${:.4}", figures.cost_usd),
            format!(
                "in total, ${:.6} per question",
                figures.cost_per_question_usd
            ),
        ),
    ];
    html! {
        div class="tiles" {
            @for (value, name) in tiles {
                div class="tile" { b { (value) } span { (name) } }
            }
        }
    }
}

fn faults(figures: &Figures) -> String {
    let mut text = "failed, without an answer".to_string();
    let mut faults: Vec<_> = figures.faults.iter().collect();
    faults.sort_by_key(|(_, count)| std::cmp::Reverse(**count));
    for (at, (word, count)) in faults.into_iter().enumerate() {
        text += if at == 0 { ": " } else { ", " };
        text += &format!("{word} {count}");
    }
    text
}

fn agreement(figures: &Figures) -> Markup {
    let [both_safe, neither_safe, unknown] = figures.undecided;
    html! {
        section class="card" {
            h2 { "Against the simulator" }
            p class="note" {
                "Questions in which one proposal, held for the horizon, hits something or leaves \
                 the road and the other does not. Other questions: both end well " (both_safe)
                ", both in an accident " (neither_safe) ", unknown " (unknown) ". "
                i { "Similar" } " is an answer that lets the policy drive; it prefers neither driver, and \
                 is neither right nor wrong."
            }
            div class="two" {
                (matrix("Each question", &figures.agreement))
                (matrix("Each request alone", &figures.asking_agreement))
            }
        }
    }
}

fn matrix(title: &str, agreement: &Agreement) -> Markup {
    let rows = ["the expert is safer", "the policy is safer"];
    let class = |row: usize, column: usize| match (agreement.counts[row][column], column) {
        (0, _) => "zero",
        (_, column) if column == row => "hit",
        (_, 0 | 1) => "miss",
        _ => "",
    };
    let share = agreement.of_preferences();
    html! {
        div {
            h2 { (title) }
            table class="matrix" {
                tr { th {} @for said in Said::ALL { th { (said.word()) } } }
                @for (row, name) in rows.into_iter().enumerate() {
                    tr {
                        th { (name) }
                        @for column in 0..Said::ALL.len() {
                            td class=(class(row, column)) { (agreement.counts[row][column]) }
                        }
                    }
                }
            }
            p {
                span class="big" { (percent(share)) } " right of the preferences "
                span class="note" { (interval(share)) }
                br;
                (percent(agreement.of_all())) " right of all "
                span class="note" { (interval(agreement.of_all())) }
                " · Cohen's kappa "
                (agreement.kappa().map_or("–".into(), |kappa| format!("{kappa:.2}")))
            }
        }
    }
}

fn slots(figures: &Figures) -> Markup {
    let mut rows = vec![("first path".to_string(), figures.first_place)];
    let hues = figures.hues.iter();
    rows.extend(hues.map(|(hue, share)| (hue.to_string(), *share)));
    let flips = figures.flips;
    html! {
        section class="card" {
            h2 { "Position and colour" }
            p class="note" {
                "How often a reply preferred the first path, and the path of each colour where it \
                 was shown, with 95 % intervals. Positions and colours are random: without bias each is half."
            }
            @if figures.first_place.trials > 0 {
                (charts::shares(&rows))
            } @else {
                p { "No reply preferred a path." }
            }
            p {
                "Asked twice with the paths swapped: " b { (flips.consistent) } " agree, "
                b { (flips.place) } " chose the same position both times, " b { (flips.mixed) }
                " one path once and similar once."
            }
        }
    }
}

fn calibration(figures: &Figures) -> Markup {
    html! {
        section class="card" {
            h2 { "Confidence" }
            @if let Some(error) = figures.calibration_error {
                p class="note" {
                    "Share of right preferences by stated confidence; on the line the confidence is \
                     exact. Expected calibration error " (format!("{error:.3}")) "."
                }
                (charts::calibration(&figures.calibration))
            } @else {
                p class="note" { "No preference with a confidence that can be checked." }
            }
        }
    }
}

fn times(records: &Records, figures: &Figures) -> Markup {
    html! {
        section class="card" {
            h2 { "Over the run" }
            (charts::timeline(&records.questions))
        }
        @if !figures.latencies_s.is_empty() {
            section class="card" {
                h2 { "Latency" }
                (charts::latencies(&figures.latencies_s))
            }
        }
    }
}

/// A share in per cent; "–" if nothing was counted.
pub fn percent(share: Share) -> String {
    match share.trials {
        0 => "–".into(),
        _ => format!("{:.1} %", 100.0 * share.mean()),
    }
}

/// The 95 % confidence interval of a share, in words.
pub fn interval(share: Share) -> String {
    let [low, high] = share.interval().map(|end| 100.0 * end);
    match share.trials {
        0 => "(none)".into(),
        trials => format!("({low:.1} to {high:.1} %, {} of {trials})", share.hits),
    }
}
