//! What happens to policies between two ticks.

use crate::{CanaryOutcome, Candidate, Controller, StartStage, SwapEvent, TickEnd};

impl Controller {
    /// Adopts weights: in shadow, or active. Between two ticks; never allocates, frees
    /// or waits: policies to be dropped return through `end`.
    pub fn adopt(&mut self, candidate: Candidate, tick: u64, end: &mut TickEnd) {
        let version = candidate.policy.version();
        let start = candidate.start;
        end.give_back(self.policy.adopt(candidate.policy, start));
        end.report(SwapEvent::Adopted { version, tick });
        if start == StartStage::Settled {
            end.report(SwapEvent::Promoted { version, tick });
        } else if self.limits.shadow_ticks == 0 {
            self.advance_canary(tick, end);
        }
    }

    /// Asks the weights in shadow mode about the tick's observation and records their
    /// proposal. After the tick's command is out, so that no command waits for them,
    /// and before its step.
    pub fn propose_in_shadow(&mut self) {
        let step = self.arbiter.step();
        let sees = step.observation_age_ns <= self.observation_age_ns;
        let Some(weights) = self.policy.shadow_weights().filter(|_| sees) else {
            return;
        };
        let proposal = self.policy.propose_in_shadow(step);
        self.arbiter.record_shadow(proposal, weights);
    }

    /// Counts proposals and vetoes of active and shadow weights in the last tick, and
    /// promotes, settles or rolls back what is due. After the tick's step is out.
    pub fn run_canary(&mut self, end: &mut TickEnd) {
        if !end.has_space() {
            return;
        }
        let step = self.arbiter.step();
        let (tick, episode) = (step.header.tick, step.header.episode);
        let is_vetoed = step.policy_assessment.is_vetoed();
        self.policy.count(step.policy.action(), is_vetoed, episode);
        let shadow = &step.shadow;
        if shadow.weights_version > 0 {
            let is_vetoed = shadow.assessment.is_vetoed();
            let proposal = shadow.proposal.action();
            self.policy.count_shadow(proposal, is_vetoed, episode);
        }
        self.advance_canary(tick + 1, end);
    }

    fn advance_canary(&mut self, tick: u64, end: &mut TickEnd) {
        let (outcome, discarded) = self.policy.advance(&self.limits);
        end.give_back(discarded);
        match outcome {
            Some(CanaryOutcome::Promoted { version }) => {
                end.report(SwapEvent::Promoted { version, tick })
            }
            Some(CanaryOutcome::RolledBack { version, fault }) => {
                end.report(SwapEvent::RolledBack {
                    version,
                    tick,
                    fault,
                    active: self.policy.weights(),
                })
            }
            Some(CanaryOutcome::Settled) | None => {}
        }
    }
}
