//! Parsers of numbers and names on the command line. Their errors name the valid range.

use std::ffi::OsStr;
use std::ops::RangeInclusive;

use clap::builder::TypedValueParser;
use clap::error::ErrorKind;
use shm_config::run::{RunName, name_max};
use shm_config::shortened;

/// A parser of whole numbers within a range. An option with it also sets
/// `allow_negative_numbers`, or clap would read -1 as another option.
///
/// # Errors
/// The parser returns one line with the range.
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

/// A parser of run names. Its error holds the name once, shortened; clap's own error would
/// hold the whole name twice.
#[derive(Debug, Clone, Copy)]
pub struct Name;

impl TypedValueParser for Name {
    type Value = RunName;

    fn parse_ref(
        &self,
        command: &clap::Command,
        option: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<RunName, clap::Error> {
        let text = value.to_string_lossy();
        text.parse().map_err(|_| {
            let option = option.map_or("--run <NAME>".into(), ToString::to_string);
            let message = format!(
                "invalid value '{}' for '{option}': use 1 to {} letters, digits, '-' or '_'",
                shortened(&text),
                name_max()
            );
            clap::Error::raw(ErrorKind::ValueValidation, format!("{message}\n")).with_cmd(command)
        })
    }
}
