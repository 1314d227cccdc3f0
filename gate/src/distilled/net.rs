use policy::Chain;
use shm_config::message::Preference;
use vehicle::Vehicle;

use super::features::{INPUTS, Side, party_features};
use super::file::About;
use crate::query::Question;

/// Numbers that one member of the net gives for one proposal: how safe it is, and how
/// much the pair is alike.
pub const OUTPUTS: usize = 2;

/// How probable each answer to a question is. The three add up to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Opinion {
    /// The expert's path is safer.
    pub expert: f64,
    /// The policy's path is safer.
    pub policy: f64,
    /// Neither is clearly safer.
    pub similar: f64,
    /// A feature lies outside those of the questions that the net has learned from.
    pub is_novel: bool,
}

impl Opinion {
    /// The driver that the net prefers; like "similar", no clear preference lets the
    /// policy drive.
    pub fn preference(&self) -> Preference {
        match self.expert > 0.5 {
            true => Preference::Expert,
            false => Preference::Policy,
        }
    }

    /// How probable it is that this is the right driver, 0.5 to 1.
    pub fn confidence(&self) -> f64 {
        self.expert.max(1.0 - self.expert)
    }

    /// Whether the three are probabilities.
    fn is_valid(&self) -> bool {
        let all = [self.expert, self.policy, self.similar];
        all.iter().all(|share| (0.0..=1.0).contains(share))
    }
}

/// The probabilities of the answers expert, policy and similar, by what one member of
/// the net gives for the expert's and the policy's proposal.
///
/// The first number is compared, so exchanging the proposals exchanges the answers; the
/// second is added, so it does not change "similar".
pub fn probabilities(outputs: [[f32; OUTPUTS]; 2], temperature: f64) -> [f64; 3] {
    let [expert, policy] = outputs.map(|of| of.map(f64::from));
    let ahead = expert[0] - policy[0];
    let scores = [ahead, -ahead, expert[1] + policy[1]].map(|score| score / temperature);
    let most = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let shares = scores.map(|score| (score - most).exp());
    let sum: f64 = shares.iter().sum();
    shares.map(|share| share / sum)
}

/// The distilled judge: several small nets, whose probabilities are averaged. Where they
/// disagree, the average is near one half.
#[derive(Debug, Clone)]
pub struct DistilledNet {
    chain: Chain,
    /// Where it comes from, and when it is sure.
    pub about: About,
}

impl DistilledNet {
    /// A net with what its file says about it.
    pub(super) fn new(chain: Chain, about: About) -> Self {
        Self { chain, about }
    }

    /// The layers, for the file.
    pub(super) fn chain(&self) -> &Chain {
        &self.chain
    }

    /// What the net thinks of a question; `None` when it has no features or an answer is
    /// no number.
    pub fn judge(&mut self, question: &Question, vehicle: &Vehicle) -> Option<Opinion> {
        let rows = party_features(question, vehicle, Side::Seen)?;
        self.opinion(&rows)
    }

    /// What the net thinks of the features of two proposals, the expert's first.
    pub fn opinion(&mut self, rows: &[[f32; INPUTS]; 2]) -> Option<Opinion> {
        let members = self.about.members;
        let expert = self.chain.infer(&rows[0]).to_vec();
        let policy = self.chain.infer(&rows[1]);
        let mut mean = [0.0; 3];
        for (expert, policy) in pairs(&expert).zip(pairs(policy)) {
            let shares = probabilities([expert, policy], self.about.temperature);
            for (mean, share) in mean.iter_mut().zip(shares) {
                *mean += share / members as f64;
            }
        }
        let [expert, policy, similar] = mean;
        // Rounding may exceed 1. Unlike `min`, `clamp` keeps NaN, which is no opinion.
        let opinion = Opinion {
            expert: expert.clamp(0.0, 1.0),
            policy: policy.clamp(0.0, 1.0),
            similar: similar.clamp(0.0, 1.0),
            is_novel: rows.iter().any(|row| self.about.range.is_outside(row)),
        };
        opinion.is_valid().then_some(opinion)
    }

    /// Whether the net answers, or passes the question on.
    pub fn is_sure(&self, opinion: &Opinion) -> bool {
        !opinion.is_novel && opinion.confidence() >= self.about.threshold
    }
}

/// The outputs of the members.
fn pairs(outputs: &[f32]) -> impl Iterator<Item = [f32; OUTPUTS]> {
    outputs.as_chunks::<OUTPUTS>().0.iter().copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exchanged_proposals_exchange_the_answers() {
        let (one, other) = ([1.5, 0.2], [-0.3, 0.4]);
        let [expert, policy, similar] = probabilities([one, other], 1.3);
        let [expert_now, policy_now, similar_now] = probabilities([other, one], 1.3);
        assert!((expert + policy + similar - 1.0).abs() < 1e-12);
        assert!(expert > policy);
        assert!((expert - policy_now).abs() < 1e-12 && (policy - expert_now).abs() < 1e-12);
        assert!((similar - similar_now).abs() < 1e-12);
    }

    #[test]
    fn large_scores_stay_probabilities() {
        let shares = probabilities([[1e6, 0.0], [-1e6, 0.0]], 0.01);
        assert_eq!(shares, [1.0, 0.0, 0.0]);
    }
}
