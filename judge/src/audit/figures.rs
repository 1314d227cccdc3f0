//! Figures computed from the records of a judge.

use shm_config::message::Preference;
use std::collections::BTreeMap;

use serde::Serialize;

use crate::statistics::{Bin, Share, calibration_error, kappa, quantile};
use gate::presentation::{Hue, Party, Reply};
use gate::record::{Asking, Record, Said};

/// Number of calibration bins, of equal width over [0, 1].
pub const BINS: usize = 10;

/// Which driver is safer by the simulator, if it knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Truth {
    /// Held, this driver's proposal ends well and the other one in an accident.
    Safer(Party),
    /// Both proposals end well.
    BothSafe,
    /// Both proposals end in an accident.
    NeitherSafe,
    /// The simulator has no prediction.
    Unknown,
}

impl Truth {
    /// The simulator's prediction for a question.
    pub fn of(record: &Record) -> Self {
        let Some(outlooks) = &record.foresight else {
            return Self::Unknown;
        };
        let is_accident = |party: Party| {
            let mut of_party = outlooks.iter().filter(|outlook| outlook.party == party);
            of_party.next().map(|outlook| outlook.is_accident())
        };
        match (is_accident(Party::Expert), is_accident(Party::Policy)) {
            (Some(false), Some(true)) => Self::Safer(Party::Expert),
            (Some(true), Some(false)) => Self::Safer(Party::Policy),
            (Some(false), Some(false)) => Self::BothSafe,
            (Some(true), Some(true)) => Self::NeitherSafe,
            (None, _) | (_, None) => Self::Unknown,
        }
    }
}

/// Confusion matrix of the answers. Rows: which driver is safer by the simulator
/// (expert, policy); columns: the answer, as in [`Said::ALL`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Agreement {
    /// The counts.
    pub counts: [[usize; Said::ALL.len()]; 2],
}

impl Agreement {
    /// Counts one answer or one reply.
    pub fn count(&mut self, safer: Party, said: Said) {
        let row = match safer {
            Party::Expert => 0,
            Party::Policy => 1,
        };
        self.counts[row][said as usize] += 1;
    }

    /// Count of one answer, whichever driver is safer.
    pub fn said(&self, said: Said) -> usize {
        self.counts.iter().map(|row| row[said as usize]).sum()
    }

    /// Share of the preferences that are right. "Similar" is not a preference: it must not
    /// count as right where the policy happens to be safer.
    pub fn of_preferences(&self) -> Share {
        let [expert, policy] = self.counts;
        Share {
            hits: expert[0] + policy[1],
            trials: expert[0] + expert[1] + policy[0] + policy[1],
        }
    }

    /// Share of all questions with a right preference.
    pub fn of_all(&self) -> Share {
        Share {
            trials: self.counts.iter().flatten().sum(),
            ..self.of_preferences()
        }
    }

    /// Cohen's kappa of the preferences.
    pub fn kappa(&self) -> Option<f64> {
        let [expert, policy] = self.counts;
        kappa(&[[expert[0], expert[1]], [policy[0], policy[1]]])
    }
}

/// How the two replies to one question, asked with the paths swapped, relate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Flips {
    /// The same driver both times, or similar both times.
    pub consistent: usize,
    /// The same position both times, whichever driver's path was there.
    pub place: usize,
    /// Anything else, such as a preference once and similar once.
    pub mixed: usize,
}

/// All figures of a folder of records; the JSON object of `--json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Number of questions.
    pub questions: usize,
    /// Answers for the expert.
    pub expert: usize,
    /// Answers for the policy, including "similar".
    pub policy: usize,
    /// Answers "similar", which prefer neither driver but let the policy drive.
    pub similar: usize,
    /// Abstentions: the replies disagree.
    pub abstained: usize,
    /// Questions without an answer.
    pub failed: usize,
    /// Count of each fault of the failed questions, by its keyword.
    pub faults: BTreeMap<String, usize>,
    /// Sorted latencies of the answered questions, s.
    pub latencies_s: Vec<f64>,
    /// Median latency, s.
    pub latency_median_s: Option<f64>,
    /// 99 % quantile of the latency, s.
    pub latency_p99_s: Option<f64>,
    /// Total cost, US dollars.
    pub cost_usd: f64,
    /// Cost per question, US dollars.
    pub cost_per_question_usd: f64,
    /// Number of HTTP requests.
    pub requests: u64,
    /// Answers to questions in which exactly one proposal ends in an accident.
    pub agreement: Agreement,
    /// Number of other questions: both proposals end well, both end in an accident,
    /// unknown.
    pub undecided: [usize; 3],
    /// The same for each reply alone.
    pub asking_agreement: Agreement,
    /// Share of the replies with a preference that prefer the first path.
    pub first_place: Share,
    /// For each colour, the share of preferences for its path where it was shown.
    pub hues: BTreeMap<&'static str, Share>,
    /// Relation of the two replies to each question.
    pub flips: Flips,
    /// Share of right replies by stated confidence.
    pub calibration: [Bin; BINS],
    /// Expected calibration error: weighted mean of |confidence - share of right replies|.
    pub calibration_error: Option<f64>,
}

impl Figures {
    /// Computes the figures of records.
    pub fn of(records: &[Record]) -> Self {
        let count = |preference: Option<Preference>| {
            let with = records
                .iter()
                .filter(|record| record.preference == preference);
            with.count()
        };
        let failed = count(None);
        let answered = records.iter().filter(|record| record.preference.is_some());
        let latencies_s: Vec<f64> = answered.map(|record| record.latency_s).collect();
        let cost_usd = records.iter().map(|record| record.cost_usd).sum::<f64>();
        let askings = || records.iter().flat_map(|record| &record.askings);
        let mut faults = BTreeMap::new();
        for fault in records.iter().filter_map(Record::failure) {
            *faults.entry(fault.to_string()).or_default() += 1;
        }
        let calibration = calibration(records);
        Self {
            questions: records.len(),
            expert: count(Some(Preference::Expert)),
            policy: count(Some(Preference::Policy)),
            similar: records
                .iter()
                .filter(|record| record.said() == Said::Similar)
                .count(),
            abstained: count(Some(Preference::Abstain)),
            failed,
            faults,
            latency_median_s: quantile(&latencies_s, 0.5),
            latency_p99_s: quantile(&latencies_s, 0.99),
            latencies_s,
            cost_usd,
            cost_per_question_usd: cost_usd / records.len().max(1) as f64,
            requests: askings().map(|asking| u64::from(asking.attempts)).sum(),
            agreement: agreement(records),
            undecided: [Truth::BothSafe, Truth::NeitherSafe, Truth::Unknown].map(|truth| {
                let like = records.iter().filter(|record| Truth::of(record) == truth);
                like.count()
            }),
            asking_agreement: asking_agreement(records),
            first_place: Share::of(askings().filter_map(|asking| match asking.reply? {
                Reply::First => Some(true),
                Reply::Second => Some(false),
                Reply::Similar => None,
            })),
            hues: hues(askings()),
            flips: flips(records),
            calibration_error: calibration_error(&calibration),
            calibration,
        }
    }
}

/// The answer of one reply alone.
fn said(asking: &Asking) -> Said {
    let preferred = match asking.reply {
        None => return Said::Failed,
        Some(Reply::Similar) => return Said::Similar,
        Some(Reply::First) => asking.showing.first,
        Some(Reply::Second) => asking.showing.first.other(),
    };
    match preferred {
        Party::Expert => Said::Expert,
        Party::Policy => Said::Policy,
    }
}

/// The driver whose path a reply prefers.
fn preferred(asking: &Asking) -> Option<Party> {
    said(asking).preference()
}

fn agreement(records: &[Record]) -> Agreement {
    let mut agreement = Agreement::default();
    for record in records {
        if let Truth::Safer(party) = Truth::of(record) {
            agreement.count(party, record.said());
        }
    }
    agreement
}

fn asking_agreement(records: &[Record]) -> Agreement {
    let mut agreement = Agreement::default();
    for record in records {
        let Truth::Safer(party) = Truth::of(record) else {
            continue;
        };
        for asking in &record.askings {
            agreement.count(party, said(asking));
        }
    }
    agreement
}

fn hues<'a>(askings: impl Iterator<Item = &'a Asking>) -> BTreeMap<&'static str, Share> {
    let mut hues: BTreeMap<&'static str, Share> = BTreeMap::new();
    for asking in askings {
        let Some(party) = preferred(asking) else {
            continue;
        };
        let winner: Hue = asking.showing.hue(party);
        for hue in asking.showing.hues {
            let share = hues.entry(hue.word()).or_default();
            share.trials += 1;
            share.hits += usize::from(hue == winner);
        }
    }
    hues
}

fn flips(records: &[Record]) -> Flips {
    let mut flips = Flips::default();
    for record in records {
        let [first, second] = record.askings.as_slice() else {
            continue;
        };
        let (Some(a), Some(b)) = (first.reply, second.reply) else {
            continue;
        };
        let is_turned = first.showing.first != second.showing.first;
        match (preferred(first), preferred(second)) {
            (one, other) if one == other => flips.consistent += 1,
            (Some(_), Some(_)) if is_turned && a == b => flips.place += 1,
            _ => flips.mixed += 1,
        }
    }
    flips
}

fn calibration(records: &[Record]) -> [Bin; BINS] {
    let mut bins = [Bin::default(); BINS];
    for record in records {
        let Truth::Safer(safer) = Truth::of(record) else {
            continue;
        };
        for asking in &record.askings {
            let (Some(party), Some(confidence)) = (preferred(asking), asking.confidence) else {
                continue;
            };
            let at = (confidence.clamp(0.0, 1.0) * BINS as f64) as usize;
            bins[at.min(BINS - 1)].count(party == safer, confidence);
        }
    }
    bins
}
