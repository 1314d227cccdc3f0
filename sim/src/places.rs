//! Which elements of a slice a loop needs, found without a branch for each.
//!
//! Of the bodies of a world few are near a car, and which ones they are differs from world
//! to world: in a batch the processor would guess wrong at many of them. It guesses only
//! the number of those found.

/// Bits of a mask.
const MASK: usize = u64::BITS as usize;

/// The indices of the elements for which a test holds, in ascending order. The test is
/// made of all elements, so it should be short and free of branches.
#[inline(always)]
pub(crate) fn places<T>(
    elements: &[T],
    holds: impl Fn(&T) -> bool + Copy,
) -> impl Iterator<Item = usize> {
    let chunks = elements.chunks(MASK).zip((0..).step_by(MASK));
    chunks.flat_map(move |(chunk, first)| {
        let mut mask = 0;
        for (bit, element) in chunk.iter().enumerate() {
            mask |= u64::from(holds(element)) << bit;
        }
        Bits(mask).map(move |bit| first + bit)
    })
}

/// The places of the bits that are set, from the lowest on.
struct Bits(u64);

impl Iterator for Bits {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        let bit = self.0.trailing_zeros() as usize;
        (bit < MASK).then(|| {
            self.0 &= self.0 - 1;
            bit
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn all_places_are_found_in_order(marks in prop::collection::vec(any::<bool>(), 0..200)) {
            let found: Vec<usize> = places(&marks, |&mark| mark).collect();
            let indices = 0..marks.len();
            let expected: Vec<usize> = indices.filter(|&index| marks[index]).collect();
            prop_assert_eq!(found, expected);
        }
    }
}
