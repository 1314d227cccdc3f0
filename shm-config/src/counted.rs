//! A number of things, in words.

use std::fmt::Display;

/// "1 step", "2 steps": of a noun whose plural has an s.
pub fn counted(count: impl Display + PartialEq + From<u8>, noun: &str) -> String {
    match count == 1u8.into() {
        true => format!("{count} {noun}"),
        false => format!("{count} {noun}s"),
    }
}

#[cfg(test)]
mod tests {
    use super::counted;

    #[test]
    fn one_is_no_plural() {
        let said = [0, 1, 2, 11].map(|count| counted(count, "seed"));
        assert_eq!(said, ["0 seeds", "1 seed", "2 seeds", "11 seeds"]);
    }
}
