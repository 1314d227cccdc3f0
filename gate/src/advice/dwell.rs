use shm_config::Instant;
use shm_config::config::Gate;
use shm_config::message::Preference;

/// Hysteresis: an answer for the expert takes effect at once; an answer for the policy
/// takes effect only after a minimum time with the expert and a number of consecutive
/// answers for the policy.
#[derive(Debug, Clone, Copy)]
pub struct Dwell {
    dwell_ns: u64,
    confirmations: u32,
    in_force: Preference,
    /// When the policy last stopped driving; `None` if it never did.
    lost: Option<Instant>,
    /// Consecutive answers that prefer the policy.
    in_favour: u32,
}

impl Dwell {
    /// The configured hysteresis, without a preference yet.
    pub fn new(config: &Gate) -> Self {
        Self {
            dwell_ns: (config.dwell_s * 1e9) as u64,
            confirmations: config.confirmations,
            in_force: Preference::Abstain,
            lost: None,
            in_favour: 0,
        }
    }

    /// Forgets the preference, because a new episode begins.
    pub fn begin(&mut self) {
        self.in_force = Preference::Abstain;
        self.lost = None;
        self.in_favour = 0;
    }

    /// Takes in an answer.
    pub fn hear(&mut self, answer: Preference, now: Instant) {
        match answer {
            Preference::Policy => self.in_favour = self.in_favour.saturating_add(1),
            Preference::Expert | Preference::Abstain => {
                self.in_favour = 0;
                if self.in_force == Preference::Policy {
                    self.lost = Some(now);
                }
                self.in_force = answer;
            }
        }
    }

    /// The preference in force. Call it at every step: the end of the dwell time can
    /// change it without a new answer.
    pub fn in_force(&mut self, now: Instant) -> Preference {
        let has_dwelt = self
            .lost
            .is_none_or(|lost| now.since_ns(lost) >= self.dwell_ns);
        if self.in_favour >= self.confirmations && has_dwelt {
            self.in_force = Preference::Policy;
        }
        self.in_force
    }
}
