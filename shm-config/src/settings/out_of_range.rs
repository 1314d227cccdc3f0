use core::fmt::{Debug, Display};
use core::ops::RangeInclusive;

/// A value that is not valid for its key.
#[cfg(feature = "std")]
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} = {value}: must be {expected}")]
pub struct OutOfRange {
    /// The key with its section, such as `planner.cell_m`.
    pub key: String,
    /// Its value.
    pub value: String,
    /// The valid values.
    pub expected: String,
}

/// A value that is not valid for its key. Without the standard library it names the key
/// alone: texts need an allocator.
#[cfg(not(feature = "std"))]
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key} is out of its range")]
pub struct OutOfRange {
    /// The key with its section, such as `planner.cell_m`.
    pub key: &'static str,
}

/// The type of a value with a range.
pub(crate) trait Number: PartialOrd + Display + Debug {
    /// What the range is called, between its two ends: `within 0.5 and 2`.
    #[cfg(feature = "std")]
    const RANGE: [&'static str; 2];
}

macro_rules! numbers {
    ($($number:ty),+: $range:expr) => { $(
        impl Number for $number {
            #[cfg(feature = "std")]
            const RANGE: [&'static str; 2] = $range;
        }
    )+ };
}
numbers!(f32, f64: ["within", "and"]);
numbers!(u32, u64, usize, i32: ["a whole number from", "to"]);

/// `value` lies in `range`.
pub(crate) fn in_range<T: Number>(
    key: &'static str,
    value: T,
    range: RangeInclusive<T>,
) -> Result<(), OutOfRange> {
    match range.contains(&value) {
        true => Ok(()),
        false => Err(refused(key, value, range)),
    }
}

#[cfg(feature = "std")]
fn refused<T: Number>(key: &str, value: T, range: RangeInclusive<T>) -> OutOfRange {
    // In a short form: not all 301 digits of 1e300.
    let mut echo = value.to_string();
    if echo.len() > ECHO_DIGITS {
        echo = format!("{value:?}");
    }
    let [from, to] = T::RANGE;
    OutOfRange {
        key: key.into(),
        value: echo,
        expected: format!("{from} {} {to} {}", range.start(), range.end()),
    }
}

#[cfg(not(feature = "std"))]
fn refused<T: Number>(key: &'static str, _: T, _: RangeInclusive<T>) -> OutOfRange {
    OutOfRange { key }
}

/// Longest number that is written digit by digit.
#[cfg(feature = "std")]
const ECHO_DIGITS: usize = 20;
