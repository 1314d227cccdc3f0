//! The policy in the tick: the active weights, those in shadow, and those kept for a
//! roll-back.
//!
//! New weights go through three stages. **Shadow**: for the canary period
//! (`policy.shadow_ticks`) they propose beside the active ones, which go on driving;
//! the step records the active ones alone. **Watched**: they are active, and those
//! before are kept for `policy.watch_ticks`. **Settled**: those before are returned.
//! Where their proposals are vetoed or jump too often, or are not finite, they are
//! rolled back to those before, in shadow or watched, between two ticks.

mod build;
mod canary;
#[cfg(feature = "process")]
mod last_good;
#[cfg(feature = "process")]
mod loader;
mod mailbox;
mod native;
mod ort;

pub use build::{Terms, build};
pub use canary::{Fault, Limits};
#[cfg(feature = "process")]
pub use loader::Loader;
pub use mailbox::{Candidate, Exchanged, Mailbox, SwapEvent, TickEnd};
pub use native::NativePolicy;
pub use ort::{OrtPolicy, OrtSession, library};

use shm_config::message::{
    FEATURES, INPUTS_WITH_MOTION, MOTION_FEATURES, Observation, Stage, Step,
};
use vehicle::Action;

use crate::PolicyAnswer;
use canary::Canary;

/// A learned driver. Called once in every tick, so it must not allocate, block
/// or take long.
pub trait Policy: Send {
    /// The normalised action for these features: those of the observation, and if it
    /// [takes](Policy::takes_motion) them those of how bodies move. Any value, checked by the
    /// caller. `None` when there is no answer in time.
    fn infer(&mut self, features: &[f32]) -> Option<Action>;

    /// Whether it takes how bodies move: then they are followed from scan to scan.
    fn takes_motion(&self) -> bool {
        false
    }

    /// Version of the weights, from 1.
    fn version(&self) -> u64;

    /// First 8 bytes of the weights' SHA-256.
    fn hash(&self) -> u64;
}

/// Asks a policy at an observation whose bodies move so (`Step::motion`); any answer, or none
/// where no policy is trained with such a scan.
pub fn ask(
    policy: &mut dyn Policy,
    (observation, motion): (&Observation, &[f32; MOTION_FEATURES]),
    workspace: &mut [f32; INPUTS_WITH_MOTION],
) -> Option<Action> {
    observation.policy_features(&mut workspace[..FEATURES])?;
    let count = match policy.takes_motion() {
        true => INPUTS_WITH_MOTION,
        false => FEATURES,
    };
    workspace[FEATURES..].copy_from_slice(motion);
    policy.infer(&workspace[..count])
}

/// A policy, and its record so far.
struct TrackedPolicy {
    policy: Box<dyn Policy>,
    canary: Canary,
}

/// How new weights begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StartStage {
    /// In shadow, for as long as the limits say.
    Shadow,
    /// Active and settled: they were good before.
    Settled,
}

/// What became of new weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CanaryOutcome {
    /// They may drive from the next tick on.
    Promoted {
        /// Their version.
        version: u64,
    },
    /// They have been active for long enough.
    Settled,
    /// They are rolled back to those before.
    RolledBack {
        /// Their version.
        version: u64,
        /// Why.
        fault: Fault,
    },
}

/// The policies, and the workspace of their input.
pub struct PolicySlot {
    /// May drive.
    active: Option<TrackedPolicy>,
    /// Those before, while the active ones are watched.
    before: Option<Box<dyn Policy>>,
    is_watched: bool,
    shadow: Option<TrackedPolicy>,
    features: [f32; INPUTS_WITH_MOTION],
}

/// Policies to be dropped outside the tick.
pub type Discarded = [Option<Box<dyn Policy>>; 3];

impl PolicySlot {
    /// With an active policy, or empty: then the expert drives and the step
    /// says so.
    pub fn new(policy: Option<Box<dyn Policy>>) -> Self {
        Self {
            active: policy.map(TrackedPolicy::new),
            before: None,
            is_watched: false,
            shadow: None,
            features: [0.0; INPUTS_WITH_MOTION],
        }
    }

    /// The stage of the policy.
    pub fn stage(&self) -> Stage {
        match (&self.active, &self.shadow) {
            (Some(_), _) => Stage::Active,
            (None, Some(_)) => Stage::Shadow,
            (None, None) => Stage::Unloaded,
        }
    }

    /// Whether one that proposes takes how bodies move.
    pub fn takes_motion(&self) -> bool {
        let proposing = self.active.iter().chain(&self.shadow);
        proposing
            .map(|tracked| &tracked.policy)
            .any(|policy| policy.takes_motion())
    }

    /// Version and hash of the active weights; zeros for none.
    pub fn weights(&self) -> (u64, u64) {
        let active = self.active.as_ref();
        active.map_or((0, 0), |tracked| {
            (tracked.policy.version(), tracked.policy.hash())
        })
    }

    /// The proposal of the active weights for the observation in this step, clamped; `None`
    /// when there are none or their answer is late or not finite.
    pub fn propose(&mut self, step: &Step) -> Option<Action> {
        let active = self.active.as_mut()?;
        active.propose(step, &mut self.features)
    }

    /// What the tick needs of the policies; they are asked only where it `sees`.
    pub fn answer(&mut self, step: &Step, sees: bool) -> PolicyAnswer {
        PolicyAnswer {
            stage: self.stage(),
            proposal: sees.then(|| self.propose(step)).flatten(),
            weights: self.weights(),
        }
    }

    /// Version and hash of the weights in shadow mode; `None` without any.
    pub fn shadow_weights(&self) -> Option<(u64, u64)> {
        let shadow = self.shadow.as_ref()?;
        Some((shadow.policy.version(), shadow.policy.hash()))
    }

    /// The same of the weights in shadow.
    pub fn propose_in_shadow(&mut self, step: &Step) -> Option<Action> {
        let shadow = self.shadow.as_mut()?;
        shadow.propose(step, &mut self.features)
    }

    /// Adopts new weights. They replace those in shadow, if any.
    pub fn adopt(&mut self, policy: Box<dyn Policy>, start: StartStage) -> Discarded {
        let superseded = self.shadow.take().map(|tracked| tracked.policy);
        match start {
            StartStage::Shadow => {
                self.shadow = Some(TrackedPolicy::new(policy));
                [superseded, None, None]
            }
            StartStage::Settled => {
                let old = self.active.replace(TrackedPolicy::new(policy));
                self.is_watched = false;
                [
                    superseded,
                    old.map(|tracked| tracked.policy),
                    self.before.take(),
                ]
            }
        }
    }

    /// Counts one tick of the active weights: the last step's proposal and verdict.
    pub fn count(&mut self, proposal: Option<Action>, is_vetoed: bool, episode: u32) {
        if let Some(tracked) = &mut self.active {
            tracked.canary.count(proposal, is_vetoed, episode);
        }
    }

    /// The same of the weights in shadow.
    pub fn count_shadow(&mut self, proposal: Option<Action>, is_vetoed: bool, episode: u32) {
        if let Some(tracked) = &mut self.shadow {
            tracked.canary.count(proposal, is_vetoed, episode);
        }
    }

    /// Promotes, settles or rolls back what is due; at most one of them. Between
    /// two ticks.
    pub fn advance(&mut self, limits: &Limits) -> (Option<CanaryOutcome>, Discarded) {
        if let Some(shadow) = &self.shadow {
            if let Some(fault) = shadow.canary.fault(limits) {
                let version = shadow.policy.version();
                let discarded = self.shadow.take().map(|tracked| tracked.policy);
                let outcome = CanaryOutcome::RolledBack { version, fault };
                return (Some(outcome), [discarded, None, None]);
            }
            if shadow.canary.ticks() >= limits.shadow_ticks {
                return self.promote();
            }
        }
        if !self.is_watched {
            return (None, [None, None, None]);
        }
        let Some(active) = &self.active else {
            return (None, [None, None, None]);
        };
        if let Some(fault) = active.canary.fault(limits) {
            let version = active.policy.version();
            let discarded = self.active.take().map(|tracked| tracked.policy);
            self.active = self.before.take().map(TrackedPolicy::new);
            self.is_watched = false;
            let outcome = CanaryOutcome::RolledBack { version, fault };
            return (Some(outcome), [discarded, None, None]);
        }
        if active.canary.ticks() >= limits.watch_ticks {
            self.is_watched = false;
            return (
                Some(CanaryOutcome::Settled),
                [self.before.take(), None, None],
            );
        }
        (None, [None, None, None])
    }

    fn promote(&mut self) -> (Option<CanaryOutcome>, Discarded) {
        let promoted = self
            .shadow
            .take()
            .map(|tracked| TrackedPolicy::new(tracked.policy));
        let old = std::mem::replace(&mut self.active, promoted);
        let older = std::mem::replace(&mut self.before, old.map(|tracked| tracked.policy));
        self.is_watched = true;
        let outcome = CanaryOutcome::Promoted {
            version: self.weights().0,
        };
        (Some(outcome), [older, None, None])
    }
}

impl TrackedPolicy {
    fn new(policy: Box<dyn Policy>) -> Self {
        Self {
            policy,
            canary: Canary::default(),
        }
    }

    fn propose(
        &mut self,
        step: &Step,
        workspace: &mut [f32; INPUTS_WITH_MOTION],
    ) -> Option<Action> {
        let seen = (&step.observation, &step.motion);
        let action = ask(&mut *self.policy, seen, workspace)?;
        if !action.is_finite() {
            self.canary.count_not_finite();
            return None;
        }
        Some(action.clamped())
    }
}
