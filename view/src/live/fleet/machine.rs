//! The machine that a mirrored run comes from, as the program that mirrors it reports.

use std::path::Path;

use serde::Serialize;
use serde_json::Value;
use shm_config::file::read_ours;
use shm_config::text::printable;

/// The report that `./vlaps join` writes once a second into its run's folder.
const REPORT: &str = "link-join.json";
/// Longest report that is read, bytes; it has a row for each service.
const REPORT_BYTES_MAX: u64 = 1 << 18;
/// The program that joins, as the kernel names its process.
const PROGRAM: &str = "vlaps-link";
/// Longest name of a process, bytes.
const NAME_BYTES_MAX: u64 = 64;
/// Longest address or name that is shown, characters.
const WORD_MAX: usize = 64;

/// Another machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// The run's name there; empty when the report does not say it.
    pub run: String,
    /// Its address and port.
    pub address: String,
    /// What stands on this machine for the run, a word: view, judge.
    pub role: String,
    /// Whether a session with it is open.
    pub is_connected: bool,
}

impl Machine {
    /// The machine of the run whose supervisor is this process, from the report in the run's
    /// folder; `None` for a run of this machine. A report that another run has left there
    /// does not count.
    pub fn of(supervisor: u32, folder: &Path) -> Option<Self> {
        let name = format!("/proc/{supervisor}/comm");
        let name = shm_config::file::read(Path::new(&name), NAME_BYTES_MAX).ok()?;
        if name.trim_ascii() != PROGRAM.as_bytes() {
            return None;
        }
        Self::in_report(&read_ours(&folder.join(REPORT), REPORT_BYTES_MAX).ok()?)
    }

    fn in_report(text: &[u8]) -> Option<Self> {
        let report: Value = serde_json::from_slice(text).ok()?;
        let word = |name: &str| -> Option<String> {
            let text = printable(report[name].as_str()?).to_string();
            Some(text.chars().take(WORD_MAX).collect())
        };
        Some(Self {
            run: word("run").unwrap_or_default(),
            address: word("address")?,
            role: word("role").unwrap_or_default(),
            is_connected: report["session"]["silent_ms"].is_number(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_names_the_machine_and_whether_it_is_connected() {
        let report = br#"{"run": "drive", "address": "192.168.7.2:7452", "role": "view",
            "session": {"sessions": 2, "silent_ms": 3.5}, "rows": {}}"#;
        let machine = Machine::in_report(report).expect("a machine");
        assert_eq!(machine.address, "192.168.7.2:7452");
        assert_eq!(machine.run, "drive");
        assert!(machine.is_connected);
        let report = br#"{"address": "a\u001b[31m\u202e", "session": {"silent_ms": null}}"#;
        let machine = Machine::in_report(report).expect("a machine");
        assert!(!machine.is_connected);
        assert_eq!(machine.run, "");
        assert!(
            machine.address.chars().all(|c| c.is_ascii_graphic()),
            "{machine:?}"
        );
        for damaged in [&b""[..], b"[]", b"{\"address\": 3}", b"\xff"] {
            assert_eq!(Machine::in_report(damaged), None);
        }
    }

    #[test]
    fn a_report_that_another_program_left_does_not_count() {
        let folder = tempfile::tempdir().expect("a folder");
        let report = br#"{"address": "192.168.7.2:7452"}"#;
        std::fs::write(folder.path().join(REPORT), report).expect("a file");
        assert_eq!(Machine::of(std::process::id(), folder.path()), None);
    }
}
