//! Lines for the terminal.

use std::fmt;
use std::io::Write as _;

use shm_config::text::printable_lines;

/// Prints a line; a closed standard output is ignored.
pub fn say(line: impl fmt::Display) {
    let line = line.to_string();
    let _ = writeln!(std::io::stdout(), "{}", printable_lines(&line));
}
