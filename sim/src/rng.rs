//! The simulator's random streams, draw for draw.
//!
//! MetaDrive seeds numpy's legacy `RandomState` (MT19937) with a hash of the
//! seed's decimal text (`utils/random_utils.py`), and every scene depends on
//! numpy's own ways of turning words into integers, choices and shuffles.
//! Those few are written here; the generator is `rand_mt`'s.

use rand_mt::Mt;
use sha2::{Digest, Sha512};

/// Managers seed the things they spawn with a number below this
/// (`Randomizable.MAX_RAND_INT`).
const SPAWN_SEEDS: u32 = 65_536;
/// Things with parameters seed their parameter space with a number below this.
const PARAMETER_SEEDS: u32 = 1_000_000;

/// One random stream.
pub struct Stream {
    words: Mt,
}

impl Stream {
    /// The stream that MetaDrive's `get_np_random(seed)` returns.
    pub fn new(seed: u64) -> Stream {
        let digest = Sha512::digest(seed.to_string().as_bytes());
        let mut low = [0; 4];
        let mut high = [0; 4];
        low.copy_from_slice(&digest[..4]);
        high.copy_from_slice(&digest[4..8]);
        let (low, high) = (u32::from_le_bytes(low), u32::from_le_bytes(high));
        // The key is a big integer cut into words: no leading zero words.
        let key = [low, high];
        let key = if high == 0 { &key[..1] } else { &key[..] };
        Stream {
            words: Mt::new_with_key(key.iter().copied()),
        }
    }

    /// Uniform in [0, 1): `random_sample`, `rand`.
    pub fn unit(&mut self) -> f64 {
        let high = f64::from(self.words.next_u32() >> 5);
        let low = f64::from(self.words.next_u32() >> 6);
        (high * 67_108_864.0 + low) / 9_007_199_254_740_992.0
    }

    /// Uniform in 0..count: `randint(0, count)`. Draws nothing if there is
    /// only one answer (or none).
    pub fn below(&mut self, count: u32) -> u32 {
        if count <= 1 {
            return 0;
        }
        let largest = count - 1;
        let mask = u32::MAX >> largest.leading_zeros();
        loop {
            let value = self.words.next_u32() & mask;
            if value <= largest {
                return value;
            }
        }
    }

    /// The index of a weighted choice: `choice(n, p=weights)`.
    pub fn weighted(&mut self, weights: &[f64]) -> usize {
        let total: f64 = weights.iter().sum();
        let unit = self.unit();
        let mut sum = 0.0;
        for (index, weight) in weights.iter().enumerate() {
            sum += weight;
            if unit < sum / total {
                return index;
            }
        }
        weights.len().saturating_sub(1)
    }

    /// Shuffles in place: `shuffle(list)`.
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            let other = self.below(last as u32 + 1) as usize;
            items.swap(last, other);
        }
    }

    /// A seed for something spawned (`Randomizable.generate_seed`).
    pub fn spawn_seed(&mut self) -> u64 {
        u64::from(self.below(SPAWN_SEEDS))
    }

    /// Draws what [`Stream::parameters`] draws and forgets it.
    pub fn skip_parameters(&mut self) {
        self.below(PARAMETER_SEEDS);
    }

    /// The uniform number behind all parameters of one sample.
    ///
    /// Every parameter of a thing is drawn from a stream of its own, but all
    /// those streams get the same seed (`ParameterSpace.seed`), so one number
    /// decides them all.
    pub fn parameters(&mut self) -> Shared {
        let seed = self.below(PARAMETER_SEEDS);
        Shared {
            unit: Stream::new(u64::from(seed)).unit(),
        }
    }
}

/// The number that all parameters of one sample are made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shared {
    unit: f64,
}

impl Shared {
    /// A parameter in a range, rounded to single precision as MetaDrive
    /// stores it.
    pub fn within(self, low: f64, high: f64) -> f64 {
        f64::from((low + (high - low) * self.unit) as f32)
    }

    /// A parameter in 0..count.
    pub fn index(self, count: u8) -> u8 {
        (f64::from(count) * self.unit) as u8
    }
}
