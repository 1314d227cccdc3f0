//! One line for each kind of trouble, not one for each message: foreign traffic decides how
//! often a message comes.

use std::collections::BTreeMap;
use std::sync::Mutex;

use shm_config::Instant;

/// The same trouble is told again after this time, ns.
const AGAIN_NS: u64 = 30_000_000_000;
/// Most kinds of trouble that are known at once; more are not told. Each topic has some five.
const KINDS_MAX: usize = 256;

/// What was told, and when.
#[derive(Debug, Default)]
pub struct Lines {
    told: Mutex<BTreeMap<(&'static str, &'static str), Told>>,
}

#[derive(Debug, Clone, Copy)]
struct Told {
    at: Instant,
    /// How often it has happened since.
    since: u64,
}

impl Lines {
    /// Notes trouble of this kind with a subject, such as a topic; returns the number of times
    /// that it has happened since it was last told if it is to be told now.
    pub fn note(&self, subject: &'static str, kind: &'static str, now: Instant) -> Option<u64> {
        // A thread that panicked leaves times and counts, which are valid.
        let mut told = self.told.lock().unwrap_or_else(|error| error.into_inner());
        let is_full = told.len() >= KINDS_MAX;
        match told.get_mut(&(subject, kind)) {
            Some(last) if now.since_ns(last.at) < AGAIN_NS => {
                last.since += 1;
                None
            }
            Some(last) => {
                let since = last.since;
                *last = Told { at: now, since: 0 };
                Some(since)
            }
            None if is_full => None,
            None => {
                told.insert((subject, kind), Told { at: now, since: 0 });
                Some(0)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_trouble_is_told_once_in_a_while() {
        let lines = Lines::default();
        assert_eq!(lines.note("scan", "old", Instant(0)), Some(0));
        for k in 1..10_000 {
            assert_eq!(lines.note("scan", "old", Instant(k)), None);
        }
        assert_eq!(lines.note("odometry", "old", Instant(3)), Some(0));
        assert_eq!(lines.note("scan", "type", Instant(3)), Some(0));
        assert_eq!(lines.note("scan", "old", Instant(AGAIN_NS)), Some(9_999));
    }
}
