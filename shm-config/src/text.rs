//! Text from outside, made fit to be shown.
//!
//! Servers, models, paths, keys of a configuration, the environment and the logs of
//! other programs may hold characters on which a terminal or a browser acts without
//! drawing them: an escape sequence rewrites the screen, a bidirectional override
//! reverses a line, a zero-width character makes two names look alike. They are shown
//! as `\u{1b}`, so that they are visible and have no effect.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io;

/// A character that changes the text around it, or is invisible.
fn is_hidden(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{feff}'
            // Zero-width characters and the marks of direction.
            | '\u{200b}'..='\u{200f}'
            // Separators of lines, embeddings and overrides of direction.
            | '\u{2028}'..='\u{202e}'
            // Invisible operators, isolates of direction.
            | '\u{2060}'..='\u{206f}'
            | '\u{fff9}'..='\u{fffb}'
            // Tags: letters that nothing draws.
            | '\u{e0000}'..='\u{e007f}')
}

/// Replaces the characters that `is_meant` rejects by the output of `write`.
fn replaced<'a>(
    text: &'a str,
    is_meant: impl Fn(char) -> bool,
    write: impl Fn(&mut String, char),
) -> Cow<'a, str> {
    let is_bad = |c: char| is_hidden(c) && !is_meant(c);
    if !text.contains(is_bad) {
        return text.into();
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match is_bad(c) {
            true => write(&mut shown, c),
            false => shown.push(c),
        }
    }
    shown.into()
}

fn escape(shown: &mut String, c: char) {
    // Writing to a string never fails.
    let _ = write!(shown, "{}", c.escape_unicode());
}

/// One line of text as it may be shown: line ends and tabs are escaped, too.
pub fn printable(text: &str) -> Cow<'_, str> {
    replaced(text, |_| false, escape)
}

/// Text of several lines as it may be shown: line ends and tabs stay.
pub fn printable_lines(text: &str) -> Cow<'_, str> {
    replaced(text, |c| matches!(c, '\n' | '\t'), escape)
}

/// JSON with the same characters escaped in the way of JSON: its meaning is the same,
/// and it can be shown. Line ends and tabs between its parts stay.
pub fn printable_json(json: &str) -> Cow<'_, str> {
    replaced(
        json,
        |c| matches!(c, '\n' | '\t' | '\r'),
        |shown, c| {
            for unit in c.encode_utf16(&mut [0; 2]) {
                let _ = write!(shown, "\\u{unit:04x}");
            }
        },
    )
}

/// The words of the command line, each fit to be shown, for errors that repeat them.
pub fn printable_arguments() -> impl Iterator<Item = String> {
    std::env::args_os().map(|word| printable(&word.to_string_lossy()).into_owned())
}

/// A writer for text of several lines, such as a log. Each write must hold whole
/// characters; invalid UTF-8 is replaced.
#[derive(Debug)]
pub struct Printable<W>(pub W);

impl<W: io::Write> io::Write for Printable<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let text = String::from_utf8_lossy(bytes);
        self.0.write_all(printable_lines(&text).as_bytes())?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// An error with its causes in one line. Some errors already contain their cause: a
/// cause that ends the line is not repeated.
pub fn causes(error: &dyn std::error::Error) -> String {
    let mut line = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let told = cause.to_string();
        if !line.ends_with(&told) {
            line = format!("{line}: {told}");
        }
        next = cause.source();
    }
    line
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    /// One of each kind: ESC, DEL, CSI of C1, marks, overrides, isolates, zero
    /// width, byte-order mark, tag, separators.
    const HIDDEN: &str = "\u{1b}\u{7f}\u{9b}\0\r\u{61c}\u{200e}\u{202e}\u{2066}\u{2069}\u{200b}\
                          \u{200d}\u{2060}\u{2064}\u{feff}\u{e0041}\u{2028}\u{2029}\u{ad}";

    #[test]
    fn hidden_characters_are_shown_and_visible_ones_stay() {
        for c in HIDDEN.chars() {
            let text = format!("a{c}b");
            let expected = format!("a\\u{{{:x}}}b", u32::from(c));
            assert_eq!(printable(&text), expected);
            assert_eq!(printable_lines(&text), expected);
        }
        for plain in [
            "",
            "plain",
            "Straße, 東京, привет, 🚗 ± – \\u{1b}",
            "‘quoted’ …",
        ] {
            assert!(matches!(printable(plain), Cow::Borrowed(text) if text == plain));
        }
        assert_eq!(printable("a\n\tb"), "a\\u{a}\\u{9}b");
        assert_eq!(printable_lines("a\n\tb"), "a\n\tb");
    }

    #[test]
    fn a_writer_escapes_what_goes_through_it() {
        let mut log = Printable(Vec::new());
        log.write_all("said \u{1b}[31m\u{202e}\n".as_bytes())
            .expect("written");
        log.write_all(b"no \xff UTF-8\n").expect("written");
        let text = String::from_utf8(log.0).expect("UTF-8");
        assert_eq!(text, "said \\u{1b}[31m\\u{202e}\nno \u{fffd} UTF-8\n");
    }

    #[test]
    fn json_keeps_its_meaning() {
        let json = "{\"a\": \"\u{202e}\u{e0041}\u{9b}\"}\n";
        let shown = printable_json(json);
        assert_eq!(shown, "{\"a\": \"\\u202e\\udb40\\udc41\\u009b\"}\n");
    }

    #[test]
    fn a_cause_is_told_once() {
        let source = std::io::Error::other("is no regular file");
        let path = "x.toml".into();
        let error = crate::config::ConfigError::Read { path, source };
        let line = causes(&error);
        assert!(line.contains("x.toml"), "{line}");
        assert_eq!(line.matches("is no regular file").count(), 1, "{line}");
    }
}
