use safety::{Scene, assess};
use shm_config::config::SafetyLimits;
use shm_config::message::{Assessment, Judge as JudgeKind, Preference};
use vehicle::Vehicle;

use crate::query::{Answer, Judge, Question};

/// A rollout that stays safe for this much longer is the safer one, s: one period.
const SAFER_S: f64 = 0.1;
/// A policy that progresses less than the expert by at most this share of the expert's
/// progress counts as similar. It is a share because a rollout is short: from rest or
/// at walking speed, an expert that drives off gains little over a car that stands.
const BEHIND_SHARE: f64 = 0.1;
/// Progress up to this distance counts as none, m.
const NO_PROGRESS_M: f64 = 0.1;

/// The built-in judge: compares both rollouts by exact geometry.
pub struct Rules {
    vehicle: Vehicle,
    limits: SafetyLimits,
}

impl Rules {
    /// A judge for this vehicle.
    pub fn new(vehicle: Vehicle, limits: SafetyLimits) -> Self {
        Self { vehicle, limits }
    }
}

impl Judge for Rules {
    fn kind(&self) -> JudgeKind {
        JudgeKind::Rules
    }

    fn ask(&mut self, question: &Question) -> Answer {
        let speed_mps = question.observation.ego.speed_mps;
        let reach_m = Scene::reach_m(&self.vehicle, &self.limits, speed_mps);
        let scene = Scene::new(&question.observation, reach_m);
        let [expert, policy] = [question.expert, question.policy]
            .map(|proposal| assess(&self.vehicle, &self.limits, &scene, proposal.action()));
        let preference = match (question.expert.action(), question.policy.action()) {
            (_, None) => Preference::Abstain,
            (None, Some(_)) if policy.is_vetoed() => Preference::Abstain,
            (None, Some(_)) => Preference::Policy,
            (Some(_), Some(_)) => compare(&expert, &policy),
        };
        Answer::free(question.id(), preference)
    }
}

/// Compares safety first, then progress. Similar means that the policy may drive (the
/// prompt's 0 of Sec. 8.5).
fn compare(expert: &Assessment, policy: &Assessment) -> Preference {
    if policy.safe_s < expert.safe_s - SAFER_S {
        return Preference::Expert;
    }
    if policy.safe_s > expert.safe_s + SAFER_S {
        return Preference::Policy;
    }
    let behind_m = (BEHIND_SHARE * expert.progress_m).max(NO_PROGRESS_M);
    if policy.progress_m < expert.progress_m - behind_m {
        return Preference::Expert;
    }
    Preference::Policy
}
