//! One question on the page.

use maud::{Markup, html};
use shm_config::counted;

use super::charts::seconds;
use super::figures::Truth;
use super::{Pictures, Shown};
use gate::presentation::{Hue, Party, Reply, Showing};
use gate::query::Occasion;
use gate::record::{Aftermath, Asking, Outlook, Proposed, Record};

pub fn question(record: &Record, pictures: &Pictures) -> Markup {
    html! {
        details class="card question" id=(format!("q{}", record.question)) {
            summary {
                b { "#" (record.question) }
                span class=(format!("badge {}", record.said().word())) { (record.said().word()) }
                (mark(record))
                span class="note" {
                    "episode " (record.episode) ", tick " (record.tick) " · "
                    (occasion(record.occasion)) " · " (format!("{:.1} m/s", record.speed_mps))
                    " · " (seconds(record.latency_s))
                    @if record.cost_usd > 0.0 { (format!(" · ${:.6}", record.cost_usd)) }
                    @if !record.fault.is_empty() { " · " (record.fault) }
                }
            }
            div class="askings" {
                @for asking in &record.askings { (one_asking(asking, pictures)) }
            }
            (proposals(record))
            p class="note" { (aftermath(record.aftermath.as_ref())) }
        }
    }
}

/// Whether the answer is right, where that is known.
fn mark(record: &Record) -> Markup {
    let Truth::Safer(party) = Truth::of(record) else {
        return html! {};
    };
    match record.said().preference() {
        Some(preferred) if preferred == party => html! { span class="right" { "✓ right" } },
        Some(_) => html! { span class="wrong" { "✗ wrong: the " (word(party)) " is safer" } },
        None => html! { span class="note" { "the " (word(party)) " is safer" } },
    }
}

fn one_asking(asking: &Asking, pictures: &Pictures) -> Markup {
    html! {
        div class="asking" {
            @match pictures.shown(&asking.picture) {
                Shown::Embedded(url) => { img src=(url) alt="what the judge was shown"; }
                Shown::Linked(link) => { p { a href=(link) { "picture: " (asking.picture) } } }
                Shown::Nowhere => { p class="note" { "The picture is missing." } }
            }
            p {
                @for party in [asking.showing.first, asking.showing.first.other()] {
                    span class="legend" {
                        (swatch(asking.showing.hue(party)))
                        (asking.showing.letter(party)) " = " (word(party))
                    }
                }
            }
            p {
                b { (reply(asking)) }
                @if let Some(confidence) = asking.confidence {
                    (format!(", confidence {confidence:.2}"))
                }
                span class="note" {
                    " · " (seconds(asking.latency_s)) " · " (asking.attempts)
                    @if asking.attempts == 1 { " request · " } @else { " requests · " }
                    (asking.tokens_in) " + " (asking.tokens_out) " tokens"
                }
            }
            @if !asking.said.is_empty() { pre { (asking.said) } }
            details class="fold" {
                summary { "the prompt" }
                @if !asking.system.is_empty() { pre { (asking.system) } }
                pre { (asking.user) }
            }
        }
    }
}

fn swatch(hue: Hue) -> Markup {
    let [red, green, blue] = hue.rgb();
    let style = format!("background:rgb({red},{green},{blue})");
    html! { span class="swatch" style=(style) {} }
}

/// A reply in words.
fn reply(asking: &Asking) -> String {
    let Showing { first, .. } = asking.showing;
    let [a, b] = Showing::LETTERS;
    match (asking.reply, &asking.fault) {
        (Some(Reply::First), _) => format!("{a} is safer: the {}", word(first)),
        (Some(Reply::Second), _) => format!("{b} is safer: the {}", word(first.other())),
        (Some(Reply::Similar), _) => "similar".into(),
        (None, Some(fault)) => format!("no reply: {fault}"),
        (None, None) => "no reply".into(),
    }
}

/// Both proposals: the actions, the safety check's measurements, and the simulator's
/// prediction.
fn proposals(record: &Record) -> Markup {
    let both = [
        (Party::Expert, record.expert),
        (Party::Policy, record.policy),
    ];
    html! {
        table {
            tr {
                th {} th { "steering" } th { "pedal" } th { "clearance" } th { "safe for" }
                th { "safety check" } th { "simulator, action held" }
            }
            @for (party, proposed) in both {
                tr {
                    td { (word(party)) }
                    @match proposed {
                        Some(proposed) => { (measured(&proposed)) }
                        None => { td colspan="5" class="note" { "no proposal" } }
                    }
                    td { (foreseen(record, party)) }
                }
            }
        }
    }
}

fn measured(proposed: &Proposed) -> Markup {
    html! {
        td { (format!("{:+.3}", proposed.steer)) }
        td { (format!("{:+.3}", proposed.pedal)) }
        td { (format!("{:.1} m", proposed.clearance_m)) }
        td { (seconds(proposed.safe_s)) }
        td { @if proposed.vetoed { "vetoed" } @else { "allowed" } }
    }
}

fn foreseen(record: &Record, party: Party) -> String {
    let mut outlooks = record.foresight.iter().flatten();
    let Some(outlook) = outlooks.find(|outlook: &&Outlook| outlook.party == party) else {
        return "unknown".into();
    };
    let mut found = Vec::new();
    if outlook.contact_s < outlook.horizon_s {
        found.push(format!("hits after {}", seconds(outlook.contact_s)));
    }
    if outlook.out_s < outlook.horizon_s {
        found.push(format!("leaves the road after {}", seconds(outlook.out_s)));
    }
    match found.is_empty() {
        true => format!("no accident in {}", seconds(outlook.horizon_s)),
        false => found.join(", "),
    }
}

fn aftermath(aftermath: Option<&Aftermath>) -> String {
    let Some(after) = aftermath else {
        return "The following seconds are unknown: the run ended.".into();
    };
    let mut text = format!(
        "In the following {}: expert {}, policy {}, brake {}; vetoed in {}; smallest clearance \
         {:.1} m.",
        counted(after.ticks, "tick"),
        after.expert,
        after.policy,
        after.brake,
        after.vetoed,
        after.clearance_m
    );
    if after.ended {
        text += " The episode ended.";
    }
    text
}

fn word(party: Party) -> &'static str {
    match party {
        Party::Expert => "expert",
        Party::Policy => "policy",
    }
}

fn occasion(occasion: Occasion) -> &'static str {
    match occasion {
        Occasion::Episode => "an episode began",
        Occasion::Period => "the period elapsed",
        Occasion::Differ => "the proposals differ",
        Occasion::Clearance => "small clearance",
    }
}
