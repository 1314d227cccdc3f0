//! Asks the processor for memory that a later tick reads.
//!
//! A batch steps each world once in a round, and by the next round a few hundred worlds
//! have left the second-level cache. What a tick reads is scattered over a dozen arrays,
//! and each waits for the one before it; asked for beforehand, they come side by side
//! while other worlds are stepped.

/// Bytes of a cache line.
pub(crate) const LINE: usize = 64;

/// Asks for all of a slice.
#[inline(always)]
pub(crate) fn slice<T>(of: &[T]) {
    let begin = of.as_ptr().cast::<u8>();
    let bytes = size_of_val(of) + begin.addr() % LINE;
    for line in 0..bytes.div_ceil(LINE) {
        line_of(begin.wrapping_add(line * LINE));
    }
}

/// Asks for the first bytes of a value, a count known to the compiler: a loop of varying
/// length costs a wrong guess of the processor, as much as three lines that are not needed.
#[inline(always)]
pub(crate) fn first<const BYTES: usize, T>(of: &T) {
    let begin = std::ptr::from_ref(of).cast::<u8>();
    for line in 0..BYTES.div_ceil(LINE) {
        line_of(begin.wrapping_add(line * LINE));
    }
    line_of(begin.wrapping_add(BYTES - 1));
}

/// Asks for a value of at most a line, or for both ends of a longer one.
#[inline(always)]
pub(crate) fn value<T>(of: &T) {
    let begin = std::ptr::from_ref(of).cast::<u8>();
    line_of(begin);
    line_of(begin.wrapping_add(size_of::<T>() - 1));
}

#[inline(always)]
#[allow(unsafe_code)] // The instruction takes a pointer.
fn line_of(place: *const u8) {
    #[cfg(target_arch = "x86_64")]
    {
        use core::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a prefetch reads nothing and never faults.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(place.cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = place;
}
