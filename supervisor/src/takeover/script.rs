//! Keys from a file, for tests and repeatable experiments.

use std::collections::VecDeque;
use std::path::Path;

use shm_config::file::read_text;
use shm_config::shortened;

use crate::cli::failure::Failure;
use crate::takeover::key::Key;

/// Longest file, bytes: a key each second for more than a day.
const BYTES_MAX: u64 = 1 << 20;
/// The latest time of a key, s: that of the longest run.
const TIME_MAX_S: f64 = 1e7;

/// Keys with the time each goes down, in order.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct KeyScript {
    /// From the start of the run, ns.
    presses: VecDeque<(u64, Key)>,
}

impl KeyScript {
    /// Reads a file of lines `TIME_S KEY`.
    ///
    /// # Errors
    /// When it cannot be read, or at its first line that is wrong.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let text = read_text(path, BYTES_MAX)
            .map_err(|error| Failure::Usage(format!("--keys {}: {error}", path.display())))?;
        Self::parse(&text)
            .map_err(|error| Failure::Usage(format!("--keys {}:{error}", path.display())))
    }

    /// Parses such lines. Empty lines and lines that begin with `#` are skipped; upper and
    /// lower case are equal.
    ///
    /// # Errors
    /// The number of the first wrong line, and why; or that there is no key.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut presses = VecDeque::new();
        let mut last_ns = 0;
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let wrong = |why: &str| Err(format!("{}: {}: {why}", index + 1, shortened(line)));
            let mut words = line.split_whitespace();
            let (Some(time), Some(word), None) = (words.next(), words.next(), words.next()) else {
                return wrong("write it as TIME_S KEY, such as 2.5 space");
            };
            let time_s = match time.parse::<f64>() {
                Ok(time_s) if (0.0..=TIME_MAX_S).contains(&time_s) => time_s,
                _ => return wrong("the time must be seconds from the start of the run"),
            };
            let Some(key) = key(word) else {
                return wrong("the key must be space, left, right, up, down, w, a, s, d, esc or q");
            };
            let time_ns = (time_s * 1e9) as u64;
            if time_ns < last_ns {
                return wrong("it comes after a later one; put the lines in order");
            }
            last_ns = time_ns;
            presses.push_back((time_ns, key));
        }
        if presses.is_empty() {
            return Err(
                "1: no key from here to the end; write lines TIME_S KEY, such as 2.5 space".into(),
            );
        }
        Ok(Self { presses })
    }

    /// The next key that is due, with its time; `None` when none is.
    pub fn due(&mut self, passed_ns: u64) -> Option<(u64, Key)> {
        self.presses
            .pop_front_if(|(time_ns, _)| *time_ns <= passed_ns)
    }
}

fn key(word: &str) -> Option<Key> {
    match word.to_ascii_lowercase().as_str() {
        "space" => Some(Key::Switch),
        "esc" | "q" => Some(Key::GiveBack),
        "left" | "a" => Some(Key::Left),
        "right" | "d" => Some(Key::Right),
        "up" | "w" => Some(Key::Gas),
        "down" | "s" => Some(Key::Brake),
        _ => None,
    }
}
