//! What the records of a judge say, in numbers.

use shm_config::message::Preference;
use std::collections::BTreeMap;

use serde::Serialize;

use crate::statistics::{Share, kappa, quantile};
use gate::presentation::{Hue, Party, Reply};
use gate::record::{Asking, Record, Said};

/// Bins of the calibration, of equal width over [0, 1].
pub const BINS: usize = 10;

/// Which driver is safer by the simulator, where it knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Truth {
    /// Held, one proposal ends in an accident and the other, this party's, not.
    Safer(Party),
    /// Both end well.
    BothSafe,
    /// Both end in an accident.
    NeitherSafe,
    /// There is no look-ahead.
    Unknown,
}

impl Truth {
    /// What the simulator said of a question.
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

/// Answers against the simulator. Rows: which driver is safer (expert, policy);
/// columns: what was said, as in [`Said::ALL`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Agreement {
    /// The counts.
    pub counts: [[usize; Said::ALL.len()]; 2],
}

impl Agreement {
    /// Counts one question, or one asking.
    pub fn count(&mut self, safer: Party, said: Said) {
        let row = match safer {
            Party::Expert => 0,
            Party::Policy => 1,
        };
        self.counts[row][said as usize] += 1;
    }

    /// How often this was the answer, whichever driver is safer.
    pub fn said(&self, said: Said) -> usize {
        self.counts.iter().map(|row| row[said as usize]).sum()
    }

    /// Right ones, of the preferences. "Similar" prefers neither: it must not count
    /// as right where the policy happens to be safer.
    pub fn of_preferences(&self) -> Share {
        let [expert, policy] = self.counts;
        Share {
            hits: expert[0] + policy[1],
            trials: expert[0] + expert[1] + policy[0] + policy[1],
        }
    }

    /// Right preferences, of all that was asked.
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

/// What two askings of one question, the paths swapped, said together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Flips {
    /// The same party both times, or similar both times.
    pub consistent: usize,
    /// The same place both times, whosever path was there.
    pub place: usize,
    /// Anything else, such as a preference once and similar once.
    pub mixed: usize,
}

/// One bin of the calibration.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Bin {
    /// Right answers of those with this confidence.
    pub right: Share,
    /// Sum of the confidences said.
    pub confidence_sum: f64,
}

/// All figures of a folder of records; the object of `--json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Figures {
    /// Questions.
    pub questions: usize,
    /// Answered for the expert.
    pub expert: usize,
    /// Answered for the policy, "similar" among them.
    pub policy: usize,
    /// Of those for the policy: the answer is "similar", which prefers neither.
    pub similar: usize,
    /// Without an answer that counts: the askings disagree.
    pub abstained: usize,
    /// Without an answer.
    pub failed: usize,
    /// Why these questions failed, by the word of the fault.
    pub faults: BTreeMap<String, usize>,
    /// Seconds from question to answer, of those answered, in order.
    pub latencies_s: Vec<f64>,
    /// Their median.
    pub latency_median_s: Option<f64>,
    /// 99 % are below.
    pub latency_p99_s: Option<f64>,
    /// US dollars, all of them.
    pub cost_usd: f64,
    /// US dollars a question.
    pub cost_per_question_usd: f64,
    /// HTTP requests.
    pub requests: u64,
    /// Questions with exactly one accident ahead: answers against the simulator.
    pub agreement: Agreement,
    /// Questions whose paths both end well, both in an accident, and those of
    /// which is unknown.
    pub undecided: [usize; 3],
    /// The same for each asking on its own.
    pub asking_agreement: Agreement,
    /// Askings that preferred the first path, of those with a preference.
    pub first_place: Share,
    /// How often the path of a hue was preferred, of the preferences about it.
    pub hues: BTreeMap<&'static str, Share>,
    /// Askings in pairs.
    pub flips: Flips,
    /// Confidence against being right.
    pub calibration: [Bin; BINS],
    /// Mean distance between confidence and share of right answers, weighted.
    pub calibration_error: Option<f64>,
}

impl Figures {
    /// Sums records up.
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

/// What one asking says on its own.
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

/// Whose path a reply prefers.
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
            let bin = &mut bins[at.min(BINS - 1)];
            bin.right.trials += 1;
            bin.right.hits += usize::from(party == safer);
            bin.confidence_sum += confidence;
        }
    }
    bins
}

/// The expected calibration error.
fn calibration_error(bins: &[Bin; BINS]) -> Option<f64> {
    let total: usize = bins.iter().map(|bin| bin.right.trials).sum();
    let off: f64 = bins
        .iter()
        .map(|bin| (bin.confidence_sum - bin.right.hits as f64).abs())
        .sum();
    (total > 0).then(|| off / total as f64)
}
