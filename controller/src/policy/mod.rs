//! The policy in the tick: who proposes, who is tried in shadow, who waits to
//! come back.
//!
//! New weights go through three stages. **Shadow**: for `policy.probation_ticks`
//! they propose beside those in charge, which go on driving; the step records
//! those in charge alone. **Watched**: they are in charge, and those before stay
//! at hand for `policy.watch_ticks`. **Settled**: those before are given back.
//! Where their proposals are vetoed or jump too often, or are no numbers, they
//! are given up for those before: in shadow or watched, by themselves, between
//! two ticks.

mod exchange;
mod good;
mod loader;
mod native;
mod ort;
mod trial;

pub use exchange::{Exchange, Hand, Look, News, Offer};
pub use loader::{Loader, Terms, build};
pub use native::NativePolicy;
pub use ort::{OrtPolicy, OrtSession, library};
pub use trial::{Fault, Limits};

use shm_config::message::{BEAMS_MAX, Observation, Stage};
use vehicle::Action;

use crate::PolicyAnswer;
use trial::Trial;

/// A learned driver. Called once in every tick, so it must not allocate, block
/// or take long.
pub trait Policy: Send {
    /// The normalised action for these features; any value, checked by the
    /// caller. `None` when there is no answer in time.
    fn infer(&mut self, features: &[f32]) -> Option<Action>;

    /// Version of the weights, from 1.
    fn version(&self) -> u64;

    /// First 8 bytes of the weights' SHA-256.
    fn hash(&self) -> u64;
}

/// A policy, and how it did so far.
struct OnTrial {
    policy: Box<dyn Policy>,
    trial: Trial,
}

/// How new weights begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Begin {
    /// In shadow, for as long as the limits say.
    Shadow,
    /// In charge, settled: they were good before.
    Settled,
}

/// What became of the weights under trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Turn {
    /// They may drive from the next tick on.
    Promoted {
        /// Their version.
        version: u64,
    },
    /// They have been in charge for long enough.
    Settled,
    /// They are given up for those before.
    RolledBack {
        /// Their version.
        version: u64,
        /// Why.
        fault: Fault,
    },
}

/// Where the policies sit, and the room for their input.
pub struct PolicySlot {
    /// May drive.
    charged: Option<OnTrial>,
    /// Those before, while those in charge are watched.
    before: Option<Box<dyn Policy>>,
    is_watched: bool,
    shadow: Option<OnTrial>,
    features: [f32; 19 + BEAMS_MAX],
}

/// Policies on their way out; whoever gets them drops them outside the tick.
pub type Discarded = [Option<Box<dyn Policy>>; 3];

impl PolicySlot {
    /// With a policy in charge, or empty: then the expert drives and the step
    /// says so.
    pub fn new(policy: Option<Box<dyn Policy>>) -> Self {
        Self {
            charged: policy.map(OnTrial::new),
            before: None,
            is_watched: false,
            shadow: None,
            features: [0.0; 19 + BEAMS_MAX],
        }
    }

    /// How far the policy is on its way to the wheel.
    pub fn stage(&self) -> Stage {
        match (&self.charged, &self.shadow) {
            (Some(_), _) => Stage::Active,
            (None, Some(_)) => Stage::Shadow,
            (None, None) => Stage::Unloaded,
        }
    }

    /// Version and hash of the weights in charge; zeros for none.
    pub fn weights(&self) -> (u64, u64) {
        let charged = self.charged.as_ref();
        charged.map_or((0, 0), |on| (on.policy.version(), on.policy.hash()))
    }

    /// The proposal of the weights in charge, clamped; `None` when there are
    /// none or their answer is late or not finite.
    pub fn propose(&mut self, observation: &Observation) -> Option<Action> {
        let charged = self.charged.as_mut()?;
        charged.propose(observation, &mut self.features)
    }

    /// What the tick needs of the policies; they are asked only where it `sees`.
    pub fn answer(&mut self, observation: &Observation, sees: bool) -> PolicyAnswer {
        PolicyAnswer {
            stage: self.stage(),
            proposal: sees.then(|| self.propose(observation)).flatten(),
            weights: self.weights(),
        }
    }

    /// Version and hash of the weights in shadow mode; `None` without any.
    pub fn shadow_weights(&self) -> Option<(u64, u64)> {
        let shadow = self.shadow.as_ref()?;
        Some((shadow.policy.version(), shadow.policy.hash()))
    }

    /// The same of the weights in shadow.
    pub fn propose_in_shadow(&mut self, observation: &Observation) -> Option<Action> {
        let shadow = self.shadow.as_mut()?;
        shadow.propose(observation, &mut self.features)
    }

    /// Takes new weights up. Those in shadow, if any, make place for them.
    pub fn adopt(&mut self, policy: Box<dyn Policy>, begin: Begin) -> Discarded {
        let superseded = self.shadow.take().map(|on| on.policy);
        match begin {
            Begin::Shadow => {
                self.shadow = Some(OnTrial::new(policy));
                [superseded, None, None]
            }
            Begin::Settled => {
                let old = self.charged.replace(OnTrial::new(policy));
                self.is_watched = false;
                [superseded, old.map(|on| on.policy), self.before.take()]
            }
        }
    }

    /// Counts one tick of the weights in charge; of the last step's proposal and
    /// verdict.
    pub fn count(&mut self, proposal: Option<Action>, is_vetoed: bool, episode: u32) {
        if let Some(on) = &mut self.charged {
            on.trial.count(proposal, is_vetoed, episode);
        }
    }

    /// The same of the weights in shadow.
    pub fn count_shadow(&mut self, proposal: Option<Action>, is_vetoed: bool, episode: u32) {
        if let Some(on) = &mut self.shadow {
            on.trial.count(proposal, is_vetoed, episode);
        }
    }

    /// Promotes, settles or rolls back what is due; at most one of them. Between
    /// two ticks.
    pub fn turn(&mut self, limits: &Limits) -> (Option<Turn>, Discarded) {
        if let Some(shadow) = &self.shadow {
            if let Some(fault) = shadow.trial.fault(limits) {
                let version = shadow.policy.version();
                let discarded = self.shadow.take().map(|on| on.policy);
                let turn = Turn::RolledBack { version, fault };
                return (Some(turn), [discarded, None, None]);
            }
            if shadow.trial.ticks() >= limits.probation_ticks {
                return self.promote();
            }
        }
        if !self.is_watched {
            return (None, [None, None, None]);
        }
        let Some(charged) = &self.charged else {
            return (None, [None, None, None]);
        };
        if let Some(fault) = charged.trial.fault(limits) {
            let version = charged.policy.version();
            let discarded = self.charged.take().map(|on| on.policy);
            self.charged = self.before.take().map(OnTrial::new);
            self.is_watched = false;
            let turn = Turn::RolledBack { version, fault };
            return (Some(turn), [discarded, None, None]);
        }
        if charged.trial.ticks() >= limits.watch_ticks {
            self.is_watched = false;
            return (Some(Turn::Settled), [self.before.take(), None, None]);
        }
        (None, [None, None, None])
    }

    fn promote(&mut self) -> (Option<Turn>, Discarded) {
        let promoted = self.shadow.take().map(|on| OnTrial::new(on.policy));
        let old = std::mem::replace(&mut self.charged, promoted);
        let older = std::mem::replace(&mut self.before, old.map(|on| on.policy));
        self.is_watched = true;
        let turn = Turn::Promoted {
            version: self.weights().0,
        };
        (Some(turn), [older, None, None])
    }
}

impl OnTrial {
    fn new(policy: Box<dyn Policy>) -> Self {
        Self {
            policy,
            trial: Trial::default(),
        }
    }

    fn propose(&mut self, observation: &Observation, room: &mut [f32]) -> Option<Action> {
        let features = observation.features(room)?;
        let action = self.policy.infer(features)?;
        if !action.is_finite() {
            self.trial.count_no_number();
            return None;
        }
        Some(action.clamped())
    }
}
