use shm_config::message::{BEAMS_MAX, Observation};
use vehicle::Action;

/// A learned driver. Called once in every tick, so it must not allocate, block
/// or take long.
pub trait Policy {
    /// The normalised action for these features; any value, checked by the caller.
    fn infer(&mut self, features: &[f32]) -> Action;

    /// Version of the weights, from 1.
    fn version(&self) -> u64;

    /// First 8 bytes of the weights' SHA-256.
    fn hash(&self) -> u64;
}

/// Where the policy sits, and the room for its input.
pub struct PolicySlot {
    policy: Option<Box<dyn Policy>>,
    features: [f32; 19 + BEAMS_MAX],
}

impl PolicySlot {
    /// With a policy, or empty: then the expert drives and the step says so.
    pub fn new(policy: Option<Box<dyn Policy>>) -> Self {
        Self {
            policy,
            features: [0.0; 19 + BEAMS_MAX],
        }
    }

    /// A policy is loaded.
    pub fn is_loaded(&self) -> bool {
        self.policy.is_some()
    }

    /// Version and hash of the loaded weights; zeros for none.
    pub fn weights(&self) -> (u64, u64) {
        self.policy
            .as_ref()
            .map_or((0, 0), |policy| (policy.version(), policy.hash()))
    }

    /// The policy's proposal, clamped; `None` when there is no policy or its
    /// answer is not finite.
    pub fn propose(&mut self, observation: &Observation) -> Option<Action> {
        let policy = self.policy.as_mut()?;
        let features = observation.features(&mut self.features)?;
        let action = policy.infer(features);
        action.is_finite().then(|| action.clamped())
    }
}
