//! The simulator's random streams, draw for draw.
//!
//! MetaDrive seeds numpy's legacy `RandomState` (MT19937) with a hash of the
//! seed's decimal text (`utils/random_utils.py`), and every scene depends on
//! numpy's own ways of turning words into integers, choices and shuffles.
//! Those few are written here; the generator is `rand_mt`'s.

mod lanes;

use rand_mt::Mt;
use sha2::{Digest, Sha512};

use lanes::{WORDS, first_words};

/// Managers seed the things they spawn with a number below this
/// (`Randomizable.MAX_RAND_INT`).
const SPAWN_SEEDS: u32 = 65_536;
/// Things with parameters seed their parameter space with a number below this.
const PARAMETER_SEEDS: u32 = 1_000_000;

/// One random stream.
pub struct Stream {
    key: [u32; 2],
    /// Its first words, of which some are used up.
    first: [u32; WORDS],
    used: usize,
    /// Made when the first words do not suffice.
    rest: Option<Box<Mt>>,
}

impl Stream {
    /// The stream that MetaDrive's `get_np_random(seed)` returns.
    pub fn new(seed: u64) -> Stream {
        let key = key_of(seed);
        Stream {
            key,
            first: [0; WORDS],
            used: WORDS,
            rest: Some(Box::new(generator(key))),
        }
    }

    /// The streams of many seeds, of each of which a few words are needed: this costs a
    /// fraction of making one after the other.
    pub(crate) fn many(seeds: &[u64]) -> Vec<Stream> {
        let keys: Vec<[u32; 2]> = seeds.iter().map(|&seed| key_of(seed)).collect();
        let found = first_words(&keys);
        let stream = |(key, first): ([u32; 2], [u32; WORDS])| Stream {
            key,
            first,
            // A key of one word is another key: its words are not those found.
            used: if key[1] == 0 { WORDS } else { 0 },
            rest: (key[1] == 0).then(|| Box::new(generator(key))),
        };
        keys.into_iter().zip(found).map(stream).collect()
    }

    fn next_u32(&mut self) -> u32 {
        if let Some(&word) = self.first.get(self.used) {
            self.used += 1;
            return word;
        }
        let key = self.key;
        let rest = self.rest.get_or_insert_with(|| {
            let mut rest = Box::new(generator(key));
            for _ in 0..WORDS {
                rest.next_u32();
            }
            rest
        });
        rest.next_u32()
    }

    /// Uniform in [0, 1): `random_sample`, `rand`.
    pub fn unit(&mut self) -> f64 {
        let high = f64::from(self.next_u32() >> 5);
        let low = f64::from(self.next_u32() >> 6);
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
            let value = self.next_u32() & mask;
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

/// What [`Stream::parameters`] gives of each stream.
pub(crate) fn parameters_of(streams: &mut [Stream]) -> Vec<Shared> {
    let seed = |stream: &mut Stream| u64::from(stream.below(PARAMETER_SEEDS));
    let seeds: Vec<u64> = streams.iter_mut().map(seed).collect();
    let shared = |mut stream: Stream| Shared {
        unit: stream.unit(),
    };
    Stream::many(&seeds).into_iter().map(shared).collect()
}

/// The key that the seed of a stream is made into: a big integer of two words, the lower
/// one first.
fn key_of(seed: u64) -> [u32; 2] {
    let digest = Sha512::digest(seed.to_string().as_bytes());
    let word = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|byte| digest[at + byte]));
    [word(0), word(4)]
}

/// The generator of a key, which has no leading zero words.
fn generator(key: [u32; 2]) -> Mt {
    let words = if key[1] == 0 { &key[..1] } else { &key[..] };
    Mt::new_with_key(words.iter().copied())
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Printed by numpy 2.4's `RandomState`, seeded as MetaDrive does it:
    /// seed, three units, `randint` below 7, 50, 10000, 65536 and 1000000
    /// (after 1, 2 and 3), a weighted choice, a shuffle of 0..12, a unit.
    #[test]
    fn draws_are_numpys() {
        type Row = (u64, [f64; 3], [u32; 8], usize, [u8; 12], f64);
        let rows: [Row; 3] = [
            (
                100,
                [0.33714631601867096, 0.7379785633962094, 0.1080190473312509],
                [0, 0, 2, 2, 23, 9625, 26583, 206633],
                0,
                [1, 11, 9, 5, 8, 6, 7, 10, 2, 3, 0, 4],
                0.5680787684862098,
            ),
            (
                65535,
                [0.4090432337720987, 0.33471447383815456, 0.06413817763568441],
                [0, 1, 0, 5, 31, 7784, 19402, 559939],
                6,
                [6, 7, 2, 11, 5, 3, 10, 1, 8, 4, 9, 0],
                0.7309715121658038,
            ),
            (
                1_099_511_627_783,
                [0.2134570731815859, 0.25854875876883476, 0.20641376402264944],
                [0, 1, 1, 5, 19, 6000, 41828, 810436],
                5,
                [8, 6, 4, 3, 2, 10, 1, 5, 11, 7, 0, 9],
                0.260396151182254,
            ),
        ];
        for (seed, units, integers, choice, shuffled, last) in rows {
            let mut stream = Stream::new(seed);
            assert_eq!(units.map(|_| stream.unit()), units, "seed {seed}");
            let below = [1, 2, 3, 7, 50, 10_000, 65_536, 1_000_000].map(|n| stream.below(n));
            assert_eq!(below, integers, "seed {seed}");
            let weights = [0.3, 0.1, 0.1, 0.1, 0.15, 0.15, 0.1];
            assert_eq!(stream.weighted(&weights), choice, "seed {seed}");
            let mut items = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];
            stream.shuffle(&mut items);
            assert_eq!(items, shuffled, "seed {seed}");
            assert_eq!(stream.unit(), last, "seed {seed}");
        }
    }

    #[test]
    fn many_streams_draw_what_each_draws_alone() {
        let seeds: Vec<u64> = (0..100).map(|k| k * k * 977).collect();
        for (&seed, mut together) in seeds.iter().zip(Stream::many(&seeds)) {
            let mut alone = Stream::new(seed);
            for draw in 0..3 * WORDS as u32 {
                let count = 2 + draw * draw * 77;
                assert_eq!(together.below(count), alone.below(count), "seed {seed}");
            }
        }
        let shared = parameters_of(&mut Stream::many(&seeds));
        for (&seed, shared) in seeds.iter().zip(shared) {
            assert_eq!(shared, Stream::new(seed).parameters(), "seed {seed}");
        }
    }

    #[test]
    fn all_parameters_of_a_sample_come_from_one_number() {
        for seed in 0..100 {
            let shared = Stream::new(seed).parameters();
            let length = (shared.within(40.0, 80.0) - 40.0) / 40.0;
            let radius = (shared.within(25.0, 60.0) - 25.0) / 35.0;
            assert!((length - radius).abs() < 1e-6, "seed {seed}");
            assert_eq!(shared.index(2) == 1, length >= 0.5, "seed {seed}");
        }
    }
}
