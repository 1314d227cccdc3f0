//! Temperature and threshold, from questions that the nets have not learned from.

use std::collections::BTreeMap;

use gate::distilled::{Opinion, probabilities};
use learner::network::{Network, Tape};

use super::samples::{Label, Learn, Sample};
use super::split::Group;
use super::train::{likelihood, pairs};

/// Temperatures that are examined, as logarithms.
const LOG_TEMPERATURES: [f64; 2] = [-3.0, 3.0];
/// Steps of the search: each leaves 0.618 of the interval, 40 a part in 10^8.
const STEPS: usize = 40;
/// The confidence from which on every question is answered.
pub const ALWAYS: f64 = 0.5;
/// The one-sided 95 % quantile of the normal distribution.
const Z: f64 = 1.644_853_626_951_472;

/// The temperature with the greatest likelihood of the labels (Guo et al. 2017), by
/// golden-section search.
pub fn temperature(members: &[Network], samples: &[Sample], of: &[usize], learn: Learn) -> f64 {
    let labelled: Vec<(usize, Label)> = of
        .iter()
        .filter_map(|index| Some((*index, samples[*index].label(learn)?)))
        .collect();
    let mut inputs = Vec::new();
    for (index, _) in &labelled {
        let rows = &samples[*index].seen;
        rows.iter().for_each(|row| inputs.extend_from_slice(row));
    }
    let outputs: Vec<Vec<_>> = members
        .iter()
        .map(|member| pairs(member.forward(&inputs, 1, &mut Tape::default())).collect())
        .collect();
    let loss = |log: f64| -> f64 {
        let losses = labelled.iter().enumerate().map(|(at, (_, label))| {
            let each = outputs
                .iter()
                .map(|of| likelihood(probabilities(of[at], log.exp()), *label));
            -(each.sum::<f64>() / members.len() as f64).ln()
        });
        losses.sum()
    };
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let [mut low, mut high] = LOG_TEMPERATURES;
    for _ in 0..STEPS {
        let (left, right) = (high - golden * (high - low), low + golden * (high - low));
        match loss(left) <= loss(right) {
            true => high = right,
            false => low = left,
        }
    }
    f64::midpoint(low, high).exp()
}

/// The least confidence at which the net answers: the greatest one at which at most this
/// share is passed on for doubt. It holds with 95 % confidence over maps, because some maps
/// have many hard questions: each opinion comes with its map. At 0.5 the net answers all
/// that is not novel.
///
/// Novel questions are left out, and are passed on beside that share: where they are many,
/// the net must not answer more of the others for it.
pub fn threshold(opinions: &[(Group, Option<Opinion>)], share: f64) -> f64 {
    let mut places: BTreeMap<Group, usize> = BTreeMap::new();
    for (map, _) in opinions {
        let next = places.len();
        places.entry(*map).or_insert(next);
    }
    let mut maps = vec![Passed::default(); places.len()];
    let mut confidences = Vec::new();
    for (map, opinion) in opinions {
        if let Some(opinion) = opinion.filter(|opinion| !opinion.is_novel) {
            let place = places[map];
            maps[place].questions += 1.0;
            confidences.push((opinion.confidence(), place));
        }
    }
    confidences.sort_by(|one, other| one.0.total_cmp(&other.0));
    let mut best = ALWAYS;
    for (confidence, place) in confidences {
        // Those before it are passed on.
        if upper(&maps) <= share {
            best = confidence;
        }
        maps[place].passed += 1.0;
    }
    best.max(ALWAYS)
}

/// Questions of a map, and those passed on.
#[derive(Clone, Copy, Default)]
struct Passed {
    questions: f64,
    passed: f64,
}

/// The upper end of the one-sided 95 % interval of the share passed on, by the ratio
/// estimator over maps; 1 for a single map.
fn upper(maps: &[Passed]) -> f64 {
    let count = maps.len() as f64;
    let questions: f64 = maps.iter().map(|map| map.questions).sum();
    let share = maps.iter().map(|map| map.passed).sum::<f64>() / questions.max(1.0);
    if count < 2.0 {
        return 1.0;
    }
    let off = maps
        .iter()
        .map(|map| (map.passed - share * map.questions).powi(2));
    let variance = count / (count - 1.0) * off.sum::<f64>() / (questions * questions).max(1.0);
    share + Z * variance.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opinion(map: u64, confidence: f64, is_novel: bool) -> (Group, Option<Opinion>) {
        let opinion = Opinion {
            expert: confidence,
            policy: 1.0 - confidence,
            similar: 0.0,
            is_novel,
        };
        (Group::Map(map), Some(opinion))
    }

    fn passed(opinions: &[(Group, Option<Opinion>)], share: f64) -> usize {
        let threshold = threshold(opinions, share);
        let is_passed = |(_, opinion): &&(Group, Option<Opinion>)| {
            opinion.is_none_or(|o| o.is_novel || o.confidence() < threshold)
        };
        opinions.iter().filter(is_passed).count()
    }

    #[test]
    fn at_most_the_stated_share_is_passed_on() {
        // Ten maps that are alike: the share is known exactly.
        let of = |k: u64| opinion(k % 10, 0.5 + 0.0005 * (k / 10) as f64, false);
        let mut opinions: Vec<_> = (0..1000).map(of).collect();
        assert_eq!(passed(&opinions, 0.0), 0);
        let count = passed(&opinions, 0.1);
        assert!((90..=100).contains(&count), "{count}");
        // Novel questions and those without an opinion do not count, and are passed on.
        for (k, opinion) in opinions[900..].iter_mut().enumerate() {
            *opinion = match k % 2 {
                0 => self::opinion(k as u64 % 10, 0.99, true),
                _ => (Group::Map(k as u64 % 10), None),
            };
        }
        let count = passed(&opinions, 0.1);
        assert!((180..=190).contains(&count), "{count}");
    }

    #[test]
    fn fewer_are_passed_on_where_maps_differ() {
        let alike = |k: u64| opinion(k % 10, 0.5 + 0.0005 * (k / 10) as f64, false);
        // All doubts are in one map.
        let apart = |k: u64| opinion(k / 100, 0.5 + 0.0005 * k as f64, false);
        let count = |of: &dyn Fn(u64) -> (Group, Option<Opinion>)| {
            passed(&(0..1000).map(of).collect::<Vec<_>>(), 0.1)
        };
        assert!(
            count(&apart) < count(&alike),
            "{} {}",
            count(&apart),
            count(&alike)
        );
        let one: Vec<_> = (0..100)
            .map(|k| opinion(0, 0.5 + 0.005 * k as f64, false))
            .collect();
        assert_eq!(passed(&one, 0.5), 0, "one map says nothing about others");
    }
}
