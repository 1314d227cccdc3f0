//! The user's text in an error: long enough to be recognised.

/// Longest echo of a value, characters.
const ECHO_MAX: usize = 60;

/// The text as it is, or its begin with an ellipsis where it is longer than 60
/// characters. Line breaks become spaces: an error is one line.
pub fn shortened(text: &str) -> String {
    let is_long = text.chars().count() > ECHO_MAX;
    let kept = text.chars().take(match is_long {
        true => ECHO_MAX - 1,
        false => ECHO_MAX,
    });
    let mut kept: String = kept
        .map(|letter| match letter {
            '\n' | '\r' | '\t' => ' ',
            letter => letter,
        })
        .collect();
    if is_long {
        kept.push('…');
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_value_is_cut_and_a_short_one_is_not() {
        assert_eq!(shortened("planner.rrt"), "planner.rrt");
        let whole = "é".repeat(ECHO_MAX);
        assert_eq!(shortened(&whole), whole);
        let cut = shortened(&"é".repeat(ECHO_MAX + 1));
        assert_eq!(cut.chars().count(), ECHO_MAX);
        assert!(cut.ends_with('…'), "{cut}");
        assert_eq!(shortened("two\nlines"), "two lines");
    }
}
