//! Numbers on the command line: what is out of range is told with the range.

use std::ops::RangeInclusive;

/// A parser of whole numbers within a range. Beside it an option has
/// `allow_negative_numbers`, or -1 would be read as another option.
///
/// # Errors
/// Of the parser: one line with the range.
pub fn whole<T: TryFrom<u64>>(
    range: RangeInclusive<u64>,
) -> impl Fn(&str) -> Result<T, String> + Clone + Send + Sync + 'static {
    move |text| {
        let number: Option<u64> = text.parse().ok().filter(|number| range.contains(number));
        number
            .and_then(|number| T::try_from(number).ok())
            .ok_or_else(|| {
                let (low, high) = (range.start(), range.end());
                match *high {
                    u64::MAX => format!("must be a whole number from {low} on"),
                    high => format!("must be a whole number from {low} to {high}"),
                }
            })
    }
}
