use std::fmt;

use shm_config::config;
use vehicle::Action;

/// Ticks before a rate counts, where the canary period is shorter: with fewer, one
/// bend taken badly would be a rate.
const EVIDENCE_TICKS: u32 = 10;

/// When weights are promoted, settled, and rolled back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Ticks in shadow.
    pub shadow_ticks: u32,
    /// Ticks as the active weights with those before kept.
    pub watch_ticks: u32,
    /// Share of ticks with a veto, [0, 1].
    pub veto_rate_max: f64,
    /// Mean change of the action from tick to tick, normalised.
    pub jump_max: f64,
}

impl From<&config::Policy> for Limits {
    fn from(policy: &config::Policy) -> Self {
        Self {
            shadow_ticks: policy.shadow_ticks,
            watch_ticks: policy.watch_ticks,
            veto_rate_max: policy.veto_rate_max,
            jump_max: policy.jump_max,
        }
    }
}

/// Why weights are rolled back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// The judge vetoed too many proposals.
    Vetoed {
        /// Proposals vetoed.
        vetoed: u32,
        /// Of this many.
        ticks: u32,
    },
    /// The proposals jump.
    Jumps {
        /// Mean change from tick to tick.
        mean: f64,
    },
    /// An answer was NaN or infinite.
    NotFinite,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Vetoed { vetoed, ticks } => write!(
                f,
                "the safety check vetoed {vetoed} of {ticks} proposals, over policy.veto_rate_max"
            ),
            Self::Jumps { mean } => write!(
                f,
                "the action jumps by {mean:.2} from tick to tick on average, over policy.jump_max"
            ),
            Self::NotFinite => write!(f, "an answer was not finite"),
        }
    }
}

/// The record of new weights: proposals, vetoes, jumps.
#[derive(Debug, Clone, Copy, Default)]
pub struct Canary {
    /// Ticks with a proposal.
    ticks: u32,
    vetoed: u32,
    jumps: u32,
    jumped: f64,
    last: Option<(Action, u32)>,
    was_not_finite: bool,
}

impl Canary {
    /// Counts one tick. Ticks without a proposal, as those of a car without
    /// an observation, do not count.
    pub fn count(&mut self, proposal: Option<Action>, is_vetoed: bool, episode: u32) {
        let Some(action) = proposal else {
            self.last = None;
            return;
        };
        self.ticks = self.ticks.saturating_add(1);
        self.vetoed += u32::from(is_vetoed);
        // Where an episode begins, the scene jumps, not the policy.
        if let Some((last, _)) = self.last.filter(|(_, of)| *of == episode) {
            let steer = (action.steer - last.steer).abs();
            self.jumped += steer.max((action.pedal - last.pedal).abs());
            self.jumps = self.jumps.saturating_add(1);
        }
        self.last = Some((action, episode));
    }

    /// An answer was NaN or infinite.
    pub fn count_not_finite(&mut self) {
        self.was_not_finite = true;
    }

    /// Ticks with a proposal.
    pub fn ticks(&self) -> u32 {
        self.ticks
    }

    /// Why the weights are to be rolled back; `None` as long as they are not.
    pub fn fault(&self, limits: &Limits) -> Option<Fault> {
        if self.was_not_finite {
            return Some(Fault::NotFinite);
        }
        if self.ticks < limits.shadow_ticks.max(EVIDENCE_TICKS) {
            return None;
        }
        let (vetoed, ticks) = (self.vetoed, self.ticks);
        if f64::from(vetoed) > limits.veto_rate_max * f64::from(ticks) {
            return Some(Fault::Vetoed { vetoed, ticks });
        }
        let mean = self.jumped / f64::from(self.jumps.max(1));
        (mean > limits.jump_max).then_some(Fault::Jumps { mean })
    }
}
