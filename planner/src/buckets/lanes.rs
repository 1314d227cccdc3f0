//! Numbers side by side.

/// Nodes of a block, and buckets of a group: loops over so many become vector instructions,
/// of as many lanes as the function they are inlined into may use.
pub(crate) const LANES: usize = 8;

/// A bit for each lane that is true, the lowest for the first.
#[inline(always)]
pub(super) fn mask(lanes: [bool; LANES]) -> u64 {
    // In lanes as wide as the numbers that were compared.
    let mut bits = [0; LANES];
    for (lane, bit) in bits.iter_mut().enumerate() {
        *bit = if lanes[lane] { 1 << lane } else { 0 };
    }
    let [a, b, c, d, e, f, g, h] = bits;
    ((a | e) | (c | g)) | ((b | f) | (d | h))
}

/// The lowest bit of a mask, which is cleared.
#[inline(always)]
pub(super) fn take_lowest(mask: &mut u64) -> Option<usize> {
    let lowest = mask.trailing_zeros();
    *mask &= mask.wrapping_sub(1);
    (lowest < u64::BITS).then_some(lowest as usize)
}

/// The least of some numbers, by halves: a single running minimum would be a chain of
/// dependent comparisons.
#[inline(always)]
pub(super) fn least_of(numbers: &[f64; LANES]) -> f64 {
    let [a, b, c, d, e, f, g, h] = *numbers;
    less(less(less(a, e), less(c, g)), less(less(b, f), less(d, h)))
}

/// The lesser of two numbers that are numbers: one instruction.
#[inline(always)]
pub(super) fn less(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The greater of two numbers that are numbers.
#[inline(always)]
pub(super) fn more(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}
