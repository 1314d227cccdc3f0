//! Text within the columns of a terminal.

use std::io::{self, IsTerminal};

use crate::cli::print::say;

/// Columns of the bar on a wide terminal, and the text around it.
const BAR_COLUMNS: usize = 40;
const AROUND_COLUMNS: usize = "  [] ".len();
/// A narrower terminal is treated as if it had this many columns.
const COLUMNS_MIN: usize = 20;

/// Prints text; on a terminal, lines that are too long are wrapped.
pub fn say_fitted(text: &str) {
    match io::stdout().is_terminal() {
        true => say(wrapped(text, columns())),
        false => say(text),
    }
}

/// Columns of the terminal; 80 when unknown.
pub(crate) fn columns() -> usize {
    match rustix::termios::tcgetwinsize(io::stdout()) {
        Ok(size) if size.ws_col > 0 => usize::from(size.ws_col).max(COLUMNS_MIN),
        _ => 80,
    }
}

/// Columns of the bar, and of the text behind it, on a terminal with `columns`.
pub(crate) fn split(columns: usize) -> (usize, usize) {
    let bar = (columns / 3).min(BAR_COLUMNS);
    (bar, columns.saturating_sub(bar + AROUND_COLUMNS))
}

/// Each line cut to the terminal: a wrapped line would not be redrawn in place.
pub(crate) fn cut(text: &str, columns: usize) -> String {
    let lines = text
        .lines()
        .map(|line| match line.chars().count() > columns {
            true => line
                .chars()
                .take(columns.saturating_sub(1))
                .chain(['…'])
                .collect(),
            false => line.into(),
        });
    lines.collect::<Vec<String>>().join("\n")
}

/// Each line wrapped between words where it is too long; continuation lines are indented
/// by four more columns.
pub(crate) fn wrapped(text: &str, columns: usize) -> String {
    let mut lines = Vec::new();
    for line in text.lines() {
        let indent = line.len() - line.trim_start().len();
        let further = " ".repeat((indent + 4).min(columns / 2));
        let mut left = line.to_string();
        while left.chars().count() > columns {
            let begin = left.len() - left.trim_start().len();
            let letters = || left.char_indices().take(columns + 1);
            let spaces = letters().filter(|(place, letter)| *letter == ' ' && *place > begin);
            // A word that is longer than the line is broken where the line ends.
            let end = spaces.last().or_else(|| letters().last());
            let rest = left.split_off(end.map_or(left.len(), |(place, _)| place));
            lines.push(left.trim_end().to_string());
            left = format!("{further}{}", rest.trim_start());
        }
        lines.push(left);
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_line_of_the_live_block_is_wider_than_the_terminal() {
        let message = "  6 %; no episode finished yet";
        for columns in COLUMNS_MIN..200 {
            let (bar, words) = split(columns);
            let line = format!("  [{}] {}", "=".repeat(bar), cut(message, words));
            assert!(line.chars().count() <= columns, "{columns}: {line}");
        }
        assert_eq!(split(80).0 + split(100).0, 26 + 33);
        assert_eq!(split(120).0, BAR_COLUMNS);
        let (_, words) = split(60);
        assert_eq!(cut(message, words), message, "60 columns hold it all");
        assert_eq!(cut("äöü\nlonger", 4), "äöü\nlon…");
    }

    #[test]
    fn a_summary_on_a_narrow_terminal_is_broken_between_words() {
        let text = "  expert: unloaded 716, vetoed 12, expired 3\nshort";
        let told = wrapped(text, 24);
        assert_eq!(
            told,
            "  expert: unloaded 716,\n      vetoed 12, expired\n      3\nshort"
        );
        let digest = "f".repeat(64);
        for columns in COLUMNS_MIN..90 {
            let told = wrapped(&format!("command digest {digest}, größer"), columns);
            let widest = told.lines().map(|line| line.chars().count()).max();
            assert!(widest <= Some(columns), "{columns}: {told}");
            let letters = |text: &str| text.chars().filter(|c| !c.is_whitespace()).count();
            assert_eq!(letters(&told), 15 - 2 + 64 + 1 + 6);
        }
        assert_eq!(wrapped("\na\n\nb", 80), "\na\n\nb");
    }
}
