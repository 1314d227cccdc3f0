//! What happens to policies between two ticks.

use crate::policy::Limits;
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
        } else if self.config.policy.probation_ticks == 0 {
            self.turn_policies(tick, hand);
        }
    }

    /// Tries the weights in shadow on what was seen in the last tick, counts how
    /// all did, and promotes, settles or rolls back what is due. After the
    /// tick's command is out, so that no command waits for a shadow.
    pub fn try_policies(&mut self, hand: &mut Hand) {
        if !hand.has_room() {
            return;
        }
        let step = &self.step;
        let (tick, episode) = (step.header.tick, step.header.episode);
        let is_vetoed = step.policy_assessment.is_vetoed();
        self.policy.count(step.policy.action(), is_vetoed, episode);
        let sees = step.observation_age_ns <= self.config.limits.observation_age_ns();
        if sees && self.policy.has_shadow() {
            let proposal = self.policy.propose_in_shadow(&self.step.observation);
            let [assessment] = self.judge(sees, [proposal]);
            self.policy
                .count_shadow(proposal, assessment.is_vetoed(), episode);
        }
        self.turn_policies(tick + 1, hand);
    }

    fn turn_policies(&mut self, tick: u64, hand: &mut Hand) {
        let (turn, discarded) = self.policy.turn(&Limits::from(&self.config.policy));
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
