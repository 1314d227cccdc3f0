//! Warnings about blocks of a training that taught the policy nothing or not all, or in which
//! it did not drive.

use shm_config::config::{Algorithm, Config, GateMode};

use super::results::Block;

/// A warning about a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockWarning {
    /// None of its steps has a label.
    Unlabelled,
    /// A policy existed, but drove none of its steps.
    Undriven,
    /// The learner did not receive all of its steps.
    Missed,
}

impl BlockWarning {
    /// All warnings.
    pub const ALL: [BlockWarning; 3] = [
        BlockWarning::Unlabelled,
        BlockWarning::Undriven,
        BlockWarning::Missed,
    ];

    /// Description, as part of a sentence.
    pub fn words(self) -> &'static str {
        match self {
            BlockWarning::Unlabelled => {
                "no step got a label: nothing new was learnt from the judge"
            }
            BlockWarning::Undriven => "the policy drove no step, though there was one",
            BlockWarning::Missed => {
                "the learner missed steps: it was not running, or took longer than \
                 limits.learner_wait_s"
            }
        }
    }
}

/// Warnings about consecutive blocks, with the step at the end of each. The first block
/// gets none: it has no policy that could drive or be preferred.
pub fn warnings(blocks: &[Block], config: &Config) -> Vec<(u64, BlockWarning)> {
    // `dagger` imitates the expert at every step and needs no labels of the judge; with
    // takeovers, a block without one is a block in which the expert found nothing to mend.
    let needs_labels =
        config.learner.algorithm != Algorithm::Dagger && config.gate.mode != GateMode::Takeover;
    let may_drive = config.gate.mode != GateMode::Expert;
    let mut found = Vec::new();
    for pair in blocks.windows(2) {
        let [before, block] = [pair[0], pair[1]];
        let labels = |block: Block| block.labels_expert + block.labels_policy;
        if needs_labels && labels(block) <= labels(before) {
            found.push((block.steps, BlockWarning::Unlabelled));
        }
        let seen = |block: Block| block.steps.saturating_sub(block.lost);
        let driven_by_others = block.interventions.saturating_sub(before.interventions);
        if may_drive && driven_by_others >= seen(block).saturating_sub(seen(before)) {
            found.push((block.steps, BlockWarning::Undriven));
        }
        if block.lost > before.lost {
            found.push((block.steps, BlockWarning::Missed));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(steps: u64, interventions: u64, labels: u64) -> Block {
        Block {
            steps,
            updates: steps,
            interventions,
            labels_expert: labels / 2,
            labels_policy: labels - labels / 2,
            expert_queries: Some(labels / 2),
            actor_loss: 0.0,
            imitation_loss: 0.0,
            critic_loss: 0.0,
            lost: 0,
        }
    }

    fn config(algorithm: Algorithm, mode: GateMode) -> Config {
        let mut config = Config::default();
        config.learner.algorithm = algorithm;
        config.gate.mode = mode;
        config
    }

    #[test]
    fn a_block_without_labels_or_without_the_policy_gets_a_warning() {
        let blocks = [
            block(200, 200, 0),
            block(400, 300, 150),
            block(600, 400, 150),
            block(800, 600, 151),
        ];
        let all = [
            (600, BlockWarning::Unlabelled),
            (800, BlockWarning::Undriven),
        ];
        let of = |algorithm, mode| warnings(&blocks, &config(algorithm, mode));
        assert_eq!(of(Algorithm::Pvp, GateMode::Rules), all);
        assert_eq!(of(Algorithm::Dagger, GateMode::Rules), all[1..]);
        assert_eq!(of(Algorithm::Pvp, GateMode::Takeover), all[1..]);
        assert_eq!(of(Algorithm::Bc, GateMode::Expert), all[..1]);
        assert_eq!(warnings(&blocks[..1], &Config::default()), []);
    }

    #[test]
    fn lost_steps_have_an_unknown_driver() {
        let mut blocks = [block(200, 200, 0), block(400, 300, 150)];
        blocks[1].lost = 100;
        let config = config(Algorithm::Pvp, GateMode::Rules);
        let both = [(400, BlockWarning::Undriven), (400, BlockWarning::Missed)];
        assert_eq!(warnings(&blocks, &config), both);
        blocks[1].lost = 99;
        assert_eq!(warnings(&blocks, &config), both[1..]);
        blocks[0].lost = 99;
        assert_eq!(warnings(&blocks, &config), []);
    }
}
