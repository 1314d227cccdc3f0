use shm_config::config::{Gate, When};
use shm_config::message::Step;
use shm_config::{Instant, Message};

use crate::query::Occasion;

/// When a judge is asked.
#[derive(Debug, Clone, Copy)]
pub struct QueryPolicy {
    when: When,
    period_ns: u64,
    spacing_ns: u64,
    differ: f64,
    clearance_m: f64,
    asked: Option<Asked>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Asked {
    taken: Instant,
    episode: u32,
}

impl QueryPolicy {
    /// The configured policy; no question was asked yet.
    pub fn new(config: &Gate) -> Self {
        Self {
            when: config.when,
            period_ns: (config.period_s * 1e9) as u64,
            spacing_ns: (config.spacing_s * 1e9) as u64,
            differ: config.differ,
            clearance_m: config.clearance_m,
            asked: None,
        }
    }

    /// Why to ask at this step; `None` when there is no reason.
    pub fn at(&self, step: &Step) -> Option<Occasion> {
        let header = step.observation.header();
        let Some(last) = self.asked else {
            return Some(Occasion::Episode);
        };
        let is_new = last.episode != header.episode || header.taken() < last.taken;
        if is_new {
            return Some(Occasion::Episode);
        }
        let since_ns = header.taken().since_ns(last.taken);
        if since_ns >= self.period_ns {
            return Some(Occasion::Period);
        }
        match self.when == When::Matters && since_ns >= self.spacing_ns {
            true => self.matters(step),
            false => None,
        }
    }

    /// Notes that a question was asked at this step.
    pub fn asked(&mut self, step: &Step) {
        let header = step.observation.header();
        self.asked = Some(Asked {
            taken: header.taken(),
            episode: header.episode,
        });
    }

    /// Whether this step matters: the proposals differ, or one of them comes near
    /// something. A single proposal leaves no choice, so there is no question.
    fn matters(&self, step: &Step) -> Option<Occasion> {
        let (expert, policy) = (step.expert.action()?, step.policy.action()?);
        let apart = (expert.steer - policy.steer)
            .abs()
            .max((expert.pedal - policy.pedal).abs());
        if apart > self.differ {
            return Some(Occasion::Differ);
        }
        let nearest_m = step
            .expert_assessment
            .clearance_m
            .min(step.policy_assessment.clearance_m);
        (nearest_m < self.clearance_m).then_some(Occasion::Clearance)
    }
}
