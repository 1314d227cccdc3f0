//! The memory of a planner, taken before the first plan: its own, allocated once, or,
//! without the standard library, the caller's.

#[cfg(feature = "std")]
use crate::PlannerConfig;
#[cfg(feature = "std")]
use crate::grid::word_count;

/// Where a planner keeps a large part of its memory: in a box of its own.
#[cfg(feature = "std")]
pub type Place<T> = Box<T>;
/// Where a planner keeps a large part of its memory: with the caller, for ever.
#[cfg(not(feature = "std"))]
pub type Place<T> = &'static mut T;

/// The bits of a grid, 64 cells a word: as many words as its settings need.
#[cfg(feature = "std")]
pub type GridWords = [u64];
/// The bits of a grid, 64 cells a word: as many words as the largest grid needs, 512 KiB.
#[cfg(not(feature = "std"))]
pub type GridWords = [u64; WORDS_MAX];

/// Words of the largest grid: `CELLS_MAX` cells along x and along y.
#[cfg(not(feature = "std"))]
const WORDS_MAX: usize = {
    use shm_config::settings::planner::CELLS_MAX;
    CELLS_MAX / u64::BITS as usize * CELLS_MAX
};

/// The words of a grid, allocated.
#[cfg(feature = "std")]
pub(crate) fn own_words(config: &PlannerConfig) -> Place<GridWords> {
    vec![!0; word_count(config)].into_boxed_slice()
}

/// The words as many as they are: they were allocated for this grid.
#[cfg(feature = "std")]
pub(crate) fn exactly(words: Place<GridWords>, _: usize) -> Place<[u64]> {
    words
}

/// The first `count` words, all cells occupied.
#[cfg(not(feature = "std"))]
pub(crate) fn exactly(words: Place<GridWords>, count: usize) -> Place<[u64]> {
    let words = &mut words[..count];
    words.fill(!0);
    words
}
