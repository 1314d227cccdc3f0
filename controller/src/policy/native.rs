use policy::{Mlp, short_hash};
use vehicle::Action;

use super::Policy;

/// A chain of layers in the native runtime: no allocation, no lock, no thread.
pub struct NativePolicy {
    mlp: Mlp,
    version: u64,
    hash: u64,
}

impl NativePolicy {
    /// The net of a file with this SHA-256.
    pub fn new(mlp: Mlp, version: u64, sha256: &[u8; 32]) -> Self {
        Self {
            mlp,
            version,
            hash: short_hash(sha256),
        }
    }
}

impl Policy for NativePolicy {
    fn infer(&mut self, features: &[f32]) -> Option<Action> {
        let [steer, pedal] = self.mlp.infer(features).map(f64::from);
        Some(Action { steer, pedal })
    }

    fn takes_motion(&self) -> bool {
        self.mlp.takes_motion()
    }

    fn version(&self) -> u64 {
        self.version
    }

    fn hash(&self) -> u64 {
        self.hash
    }
}
