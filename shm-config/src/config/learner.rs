use serde::{Deserialize, Serialize};

use super::{OutOfRange, in_range};

/// The learning algorithm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Algorithm {
    /// The paper's: proxy values from preferences, and imitation.
    Pvp,
    /// Preferences at predicted states.
    Ppl,
    /// Imitation of the steps that the expert drove.
    Bc,
    /// Imitation of the steps at which the expert was preferred.
    HgDagger,
    /// Imitation of all steps: the expert is a program.
    Dagger,
}

impl Algorithm {
    /// The algorithm's name in the configuration.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pvp => "pvp",
            Self::Ppl => "ppl",
            Self::Bc => "bc",
            Self::HgDagger => "hg-dagger",
            Self::Dagger => "dagger",
        }
    }
}

/// The learner process.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Learner {
    /// Whether a learner is part of the run.
    pub enabled: bool,
    /// The algorithm: pvp, ppl, bc, hg-dagger or dagger.
    pub algorithm: Algorithm,
    /// Seed of the networks and of samples from the replay.
    pub seed: u64,
    /// Steps in a block, after which updates follow (Sec. 5). In lockstep the
    /// controller waits at the end of each block until the learner has taken all its
    /// steps, and its policy is adopted or refused.
    pub block_steps: u32,
    /// Updates after each block. PVP4Real makes one for each step; half as many again
    /// learn more from the replay. With 0 nothing is learnt: `policy.file` drives unchanged, if one
    /// is named, and the replay is filled for `./vlaps relearn`.
    pub updates: u32,
    /// Transitions in an update. PVP4Real has 1024, PVP 128.
    pub batch: u32,
    /// Neurons of each of the two hidden layers; PVP4Real.
    pub hidden: u32,
    /// Filters of each of two convolutions over the scan, and over how bodies move, before the
    /// hidden layers; 0 for none.
    pub filters: u32,
    /// Learning rate; 0 for the algorithm's own: 1e-4 (PVP4Real) for pvp, 1e-3 for the
    /// others.
    pub rate: f64,
    /// Updates over which the rate falls in a straight line to a hundredth, where it then
    /// stays; 0 keeps it. `./vlaps train --steps` makes `learner.updates` for each
    /// `learner.block_steps`: 75,000 for 50,000 steps.
    pub decay_updates: u32,
    /// For all but pvp: how much more a pedal above the expert's counts in the imitation than
    /// one below it; over 1 the policy brakes sooner.
    pub excess_pedal: f64,
    /// Weight of the imitation loss relative to the value loss: lambda_BC of Eq. 2;
    /// PVP4Real.
    pub imitation_weight: f64,
    /// Standard deviation of the noise on the actions of pvp's targets; TD3 and
    /// PVP4Real.
    pub target_noise: f64,
    /// For pvp: how much more an error in steering counts in the imitation than one of the
    /// pedal. PVP4Real has 1.
    pub imitation_steer: f64,
    /// For pvp: the critics see the steering times this, so that they tell apart actions
    /// that differ by little. PVP4Real has 1.
    pub critic_steer: f64,
    /// The same for the pedal.
    pub critic_pedal: f64,
    /// For pvp: publish the running average of the actor, not the actor.
    pub averaged: bool,
    /// For pvp: an episode that reaches `world.horizon_ticks` ends its value, as one that
    /// arrives or leaves the road does; PVP4Real. With false the critics learn nothing from
    /// its last step. Transitions that are stored already stay as they are.
    pub truncate_as_terminate: bool,
    /// The policy also takes how the bodies around the car move, in each of 60 sectors; the
    /// expert then knows it at imagined scenes, too.
    pub motion: bool,
    /// Capacity of each replay buffer, transitions; PVP4Real.
    pub capacity: u32,
    /// For ppl: predicted states of a rejected action, 0.2 s apart.
    pub predicted_states: u32,
    /// For dagger and ppl: imagined scenes for each observed one, at which the expert
    /// is asked.
    pub imagined_scenes: u32,
    /// How long a step waits for the answer to its question, s; after that it has no
    /// label.
    #[serde(skip)]
    pub label_wait_s: f64,
}

impl Default for Learner {
    fn default() -> Self {
        Self {
            enabled: false,
            algorithm: Algorithm::Pvp,
            seed: 0,
            block_steps: 200,
            updates: 300,
            batch: 256,
            hidden: 256,
            filters: 0,
            rate: 0.0,
            decay_updates: 0,
            excess_pedal: 1.0,
            imitation_weight: 1.0,
            target_noise: 0.2,
            imitation_steer: 1.0,
            critic_steer: 1.0,
            critic_pedal: 1.0,
            averaged: false,
            truncate_as_terminate: true,
            motion: false,
            capacity: 50_000,
            predicted_states: 4,
            imagined_scenes: 3,
            label_wait_s: 35.0,
        }
    }
}

impl Learner {
    /// Whether the run trains a policy that is told how bodies move.
    pub fn trains_motion(&self) -> bool {
        self.enabled && self.motion
    }

    pub(super) fn check(&self) -> Result<(), OutOfRange> {
        let counts = [
            ("learner.block_steps", self.block_steps, 1..=1_000_000),
            ("learner.updates", self.updates, 0..=1_000_000),
            ("learner.batch", self.batch, 2..=65_536),
            ("learner.hidden", self.hidden, 1..=1024),
            ("learner.filters", self.filters, 0..=128),
            ("learner.capacity", self.capacity, 1..=10_000_000),
            ("learner.predicted_states", self.predicted_states, 0..=50),
            ("learner.imagined_scenes", self.imagined_scenes, 0..=50),
        ];
        for (key, value, range) in counts {
            in_range(key, value, range)?;
        }
        in_range("learner.rate", self.rate, 0.0..=1.0)?;
        in_range("learner.excess_pedal", self.excess_pedal, 0.01..=100.0)?;
        in_range("learner.imitation_weight", self.imitation_weight, 0.0..=1e3)?;
        in_range("learner.target_noise", self.target_noise, 0.0..=1.0)?;
        in_range("learner.imitation_steer", self.imitation_steer, 0.0..=1e3)?;
        in_range("learner.critic_steer", self.critic_steer, 0.01..=100.0)?;
        in_range("learner.critic_pedal", self.critic_pedal, 0.01..=100.0)?;
        in_range("learner.label_wait_s", self.label_wait_s, 0.0..=3600.0)
    }
}
