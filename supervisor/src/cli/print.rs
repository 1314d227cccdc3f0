//! Text on standard output.

use std::io::{self, Write};

use shm_config::text::printable_lines;

/// Writes text; a reader that has gone away is no reason to fail.
pub fn say(text: impl std::fmt::Display) {
    let mut out = io::stdout().lock();
    let _ = writeln!(out, "{}", printable_lines(&text.to_string()));
    let _ = out.flush();
}
