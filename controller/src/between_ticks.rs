//! What happens to policies between two ticks.

use crate::{Begin, Controller, Hand, News, Offer, Turn};

impl Controller {
    /// Takes weights up: in shadow, or in charge. Between two ticks; never
    /// allocates, frees or waits: what has to go, goes over `hand`.
    pub fn adopt(&mut self, offer: Offer, tick: u64, hand: &mut Hand) {
        let version = offer.policy.version();
        let begin = offer.begin;
        hand.give_back(self.policy.adopt(offer.policy, begin));
        hand.say(News::Adopted { version, tick });
        if begin == Begin::Settled {
            hand.say(News::Promoted { version, tick });
        } else if self.limits.probation_ticks == 0 {
            self.turn_policies(tick, hand);
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
        let proposal = self.policy.propose_in_shadow(&step.observation);
        self.arbiter.record_shadow(proposal, weights);
    }

    /// Counts how active and shadow weights did in the last tick, and promotes,
    /// settles or rolls back what is due. After the tick's step is out.
    pub fn try_policies(&mut self, hand: &mut Hand) {
        if !hand.has_room() {
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
        self.turn_policies(tick + 1, hand);
    }

    fn turn_policies(&mut self, tick: u64, hand: &mut Hand) {
        let (turn, discarded) = self.policy.turn(&self.limits);
        hand.give_back(discarded);
        match turn {
            Some(Turn::Promoted { version }) => hand.say(News::Promoted { version, tick }),
            Some(Turn::RolledBack { version, fault }) => hand.say(News::RolledBack {
                version,
                tick,
                fault,
                charged: self.policy.weights(),
            }),
            Some(Turn::Settled) | None => {}
        }
    }
}
