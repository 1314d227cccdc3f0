//! Text on standard output.

use std::io::{self, Write};

use shm_config::text::printable_lines;

/// Writes a line to stdout. A reader that has ended is not an error.
pub fn say(text: impl std::fmt::Display) {
    let mut out = io::stdout().lock();
    let _ = writeln!(out, "{}", printable_lines(&text.to_string()));
    let _ = out.flush();
}

/// A word as a shell reads it back: in quotes where it holds more than a plain path.
pub fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
    match !word.is_empty() && word.chars().all(is_plain) {
        true => word.into(),
        false => format!("'{}'", word.replace('\'', r"'\''")),
    }
}

#[cfg(test)]
mod tests {
    use super::quoted;

    #[test]
    fn words_are_quoted_where_a_shell_would_split_them() {
        assert_eq!(quoted("./my-robot"), "./my-robot");
        assert_eq!(quoted("/a folder/it's"), r"'/a folder/it'\''s'");
        assert_eq!(quoted(""), "''");
    }
}
