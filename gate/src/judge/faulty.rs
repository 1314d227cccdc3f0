use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::Instant;
use shm_config::config::Gate;

use crate::query::{Answer, Question, Ruling};

/// What is wrong with a judge, on purpose: answers turned round, withheld or
/// late, to find out how much of it driving and learning bear.
///
/// What happens to an answer depends on the seed and its question's tick alone,
/// so runs repeat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Flaws {
    noise: f64,
    abstention: f64,
    delay_ns: u64,
    seed: u64,
}

impl Flaws {
    /// As configured; none by default.
    pub fn new(config: &Gate) -> Self {
        Self {
            noise: config.noise,
            abstention: config.abstention,
            delay_ns: (config.delay_s * 1e9) as u64,
            seed: config.seed,
        }
    }

    /// When an answer may be heard.
    pub fn due(&self, question: &Question) -> Instant {
        let taken = question.observation.header.taken();
        taken.after_ns(self.delay_ns)
    }

    /// The ruling as it is heard.
    pub fn apply(&self, question: &Question, ruling: Ruling) -> Ruling {
        let header = &question.observation.header;
        let place = header.tick ^ (u64::from(header.episode) << 40);
        let mut random = SplitMix64::seed_from_u64(self.seed ^ place.wrapping_mul(0x9e37_79b9));
        // The first number of neighbouring seeds is alike.
        let _ = random.next_u64();
        let mut share = || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        let (turned, withheld) = (share() < self.noise, share() < self.abstention);
        let answer = match ruling.answer {
            Answer::Expert | Answer::Policy if withheld => Answer::Abstain,
            Answer::Expert if turned => Answer::Policy,
            Answer::Policy if turned => Answer::Expert,
            answer => answer,
        };
        Ruling { answer, ..ruling }
    }
}
