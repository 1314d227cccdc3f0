//! Text on standard output.

use std::io::{self, Write};

use shm_config::text::printable_lines;

/// Writes a line to stdout. A reader that has ended is not an error.
pub fn say(text: impl std::fmt::Display) {
    let mut out = io::stdout().lock();
    let _ = writeln!(out, "{}", printable_lines(&text.to_string()));
    let _ = out.flush();
}
