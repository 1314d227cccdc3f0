//! Age limits and rates of the service table in the numbers of a configuration.

use super::Config;
use crate::services::{AgeLimit, Rate};

impl Config {
    /// Age beyond which a reader refuses a message as stale, ns; the largest number
    /// when no key limits it.
    pub fn age_limit_ns(&self, limit: AgeLimit) -> u64 {
        match limit {
            AgeLimit::Observation => self.limits.observation_age_ns(),
            AgeLimit::Plan => self.plan_age_ns(),
            AgeLimit::Command => self.limits.command_age_ns(),
            AgeLimit::Takeover => self.limits.takeover_age_ns(),
            AgeLimit::OwnExpiry | AgeLimit::None => u64::MAX,
        }
    }

    /// Messages per second; `None` for messages that are published on an event.
    pub fn message_rate_hz(&self, rate: Rate) -> Option<f64> {
        match rate {
            Rate::Tick(process) => self.rate_hz(process),
            Rate::Hz(hz) => Some(hz),
            Rate::Event(_) => None,
        }
    }
}
