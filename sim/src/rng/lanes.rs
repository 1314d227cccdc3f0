//! The first words of many streams at once, a stream in each lane.
//!
//! A scene draws a few words from each of some hundred streams, and most of a stream's
//! cost is its seeding, which is one long chain of products. Chains of several streams
//! run side by side. The words are those of `rand_mt`, which the tests compare.

use std::sync::LazyLock;

use pulp::NullaryFnOnce;

use crate::simd::Width;

/// Words that are made of each stream: enough for nearly all of them.
pub(super) const WORDS: usize = 8;
/// Streams side by side.
const LANES: usize = 16;

/// The generator's state, its other tap, and its constants (Matsumoto and Nishimura,
/// 1998, with the seeding of 2002).
const STATE: usize = 624;
const TAP: usize = 397;
const TWIST: u32 = 0x9908_b0df;
const UPPER: u32 = 0x8000_0000;

type State = [[u32; LANES]; STATE];

/// The state from which every key is mixed in.
static BASE: LazyLock<[u32; STATE]> = LazyLock::new(|| {
    let mut base = [19_650_218; STATE];
    for k in 1..STATE {
        let before = base[k - 1];
        base[k] = 1_812_433_253_u32
            .wrapping_mul(before ^ (before >> 30))
            .wrapping_add(k as u32);
    }
    base
});

/// The first words of the stream of each key.
pub(super) fn first_words(keys: &[[u32; 2]]) -> Vec<[u32; WORDS]> {
    let width = Width::default();
    let mut state = Box::new([[0; LANES]; STATE]);
    let mut found = Vec::with_capacity(keys.len());
    for keys in keys.chunks(LANES) {
        let mut rows = [[0; LANES]; 2];
        for (lane, key) in keys.iter().enumerate() {
            [rows[0][lane], rows[1][lane]] = *key;
        }
        let words = width.widest.dispatch(Seeding {
            keys: &rows,
            state: &mut state,
        });
        found.extend((0..keys.len()).map(|lane| words.map(|words| words[lane])));
    }
    found
}

/// One seeding, compiled for each width of vectors.
struct Seeding<'a> {
    /// Two words of each stream's key.
    keys: &'a [[u32; LANES]; 2],
    state: &'a mut State,
}

impl NullaryFnOnce for Seeding<'_> {
    type Output = [[u32; LANES]; WORDS];

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Seeding { keys, state } = self;
        for (row, &base) in state.iter_mut().zip(BASE.iter()) {
            *row = [base; LANES];
        }
        let mut before = state[0];
        for k in 0..STATE {
            let row = 1 + k % (STATE - 1);
            if k == STATE - 1 {
                // The chain comes around: the last word is also the first.
                state[0] = before;
            }
            let word = k % 2;
            for ((before, old), key) in before.iter_mut().zip(&state[row]).zip(&keys[word]) {
                let mixed = (*before ^ (*before >> 30)).wrapping_mul(1_664_525);
                *before = (old ^ mixed).wrapping_add(*key).wrapping_add(word as u32);
            }
            state[row] = before;
        }
        for k in 0..STATE - 1 {
            let row = 1 + (k + 1) % (STATE - 1);
            for (before, old) in before.iter_mut().zip(&state[row]) {
                let mixed = (*before ^ (*before >> 30)).wrapping_mul(1_566_083_941);
                *before = (old ^ mixed).wrapping_sub(row as u32);
            }
            state[row] = before;
        }
        state[0] = [UPPER; LANES];
        std::array::from_fn(|k| temper(&state[k], &state[k + 1], &state[k + TAP]))
    }
}

/// A word of the first round after the seeding.
#[inline(always)]
fn temper(upper: &[u32; LANES], lower: &[u32; LANES], tap: &[u32; LANES]) -> [u32; LANES] {
    let mut words = [0; LANES];
    for (lane, word) in words.iter_mut().enumerate() {
        let joined = (upper[lane] & UPPER) | (lower[lane] & !UPPER);
        let twisted = tap[lane] ^ (joined >> 1) ^ ((joined & 1) * TWIST);
        let twisted = twisted ^ (twisted >> 11);
        let twisted = twisted ^ ((twisted << 7) & 0x9d2c_5680);
        let twisted = twisted ^ ((twisted << 15) & 0xefc6_0000);
        *word = twisted ^ (twisted >> 18);
    }
    words
}

#[cfg(test)]
mod tests {
    use rand_mt::Mt;

    use super::*;

    #[test]
    fn streams_side_by_side_have_the_generators_words() {
        let word = |k: u32| k.wrapping_mul(2_654_435_761) ^ (k << 7);
        for count in [1, 2, LANES - 1, LANES, LANES + 1, 3 * LANES] {
            let keys: Vec<[u32; 2]> = (0..count as u32)
                .map(|k| [word(k), word(k + 1000)])
                .collect();
            let found = first_words(&keys);
            assert_eq!(found.len(), count);
            for (key, words) in keys.iter().zip(found) {
                let mut generator = Mt::new_with_key(key.iter().copied());
                let expected = [(); WORDS].map(|()| generator.next_u32());
                assert_eq!(words, expected, "{key:?} of {count}");
            }
        }
    }
}
