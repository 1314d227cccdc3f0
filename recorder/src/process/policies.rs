//! The policy files of a run: those offered, and those in use.

use std::sync::Arc;

use shm_config::layout::Layout;
use shm_config::message::PolicyStatus;

use super::facts::hex;
use crate::read::offered;

/// Policy files that were offered and are not in use.
const OFFERS_MAX: usize = 4;

/// Policy files, by SHA-256 in hexadecimal.
pub(super) type Policies = Vec<(String, Arc<[u8]>)>;

/// Follows which policy files are in use.
#[derive(Debug)]
pub(super) struct Offers {
    /// The one that was used or offered last at the end.
    files: Policies,
    /// How the SHA-256 of those in use begin.
    used: Vec<String>,
}

impl Offers {
    /// Begins with the files that the run begins with.
    pub(super) fn new(files: Policies) -> Self {
        Self {
            used: files.iter().map(|(sha256, _)| sha256.clone()).collect(),
            files,
        }
    }

    /// Keeps the file of an offer until it is decided; `memory` is that of [`Weights`]. Returns
    /// its SHA-256.
    ///
    /// [`Weights`]: shm_config::message::Weights
    pub(super) fn note_offer(&mut self, memory: &[u8]) -> Option<String> {
        let (sha256, file) = offered(memory)?;
        let sha256 = hex(sha256);
        self.keep(sha256.clone(), file);
        Some(sha256)
    }

    fn keep(&mut self, sha256: String, file: &[u8]) {
        let known = self.files.iter().position(|(known, _)| *known == sha256);
        let entry = match known {
            Some(at) => self.files.remove(at),
            None => (sha256, file.into()),
        };
        self.files.push(entry);
        let used = &self.used;
        let is_used = |sha256: &str| used.iter().any(|start| sha256.starts_with(start));
        let mut idle = (0..self.files.len()).filter(|at| !is_used(&self.files[*at].0));
        let oldest = idle.next();
        if let Some(oldest) = oldest.filter(|_| idle.count() >= OFFERS_MAX) {
            self.files.remove(oldest);
        }
    }

    /// The files in use, as far as they are known; `memory` is that of [`PolicyStatus`].
    pub(super) fn note_status(&mut self, memory: &[u8]) -> Option<Policies> {
        let status = PolicyStatus::from_bytes(memory)?;
        self.used = [status.hash, status.offered_hash]
            .map(|hash| format!("{hash:016x}"))
            .into();
        let is_used = |sha256: &str| self.used.iter().any(|start| sha256.starts_with(start));
        // A version to which the controller returns is among those used last.
        self.files.sort_by_key(|(sha256, _)| is_used(sha256));
        let used = self.files.iter().filter(|(sha256, _)| is_used(sha256));
        Some(used.cloned().collect())
    }
}

#[cfg(test)]
pub(super) mod tests {
    use shm_config::message::Weights;

    use super::*;

    /// The memory of [`Weights`] that offers this file.
    pub(in crate::process) fn offer(sha256: [u8; 32], file: &[u8]) -> Vec<u8> {
        let mut memory = vec![0; size_of::<Weights>()];
        let count = (file.len() as u64).to_le_bytes();
        for (name, bytes) in [
            ("sha256", &sha256[..]),
            ("bytes", file),
            ("byte_count", &count),
        ] {
            let field = Weights::FIELDS.iter().find(|field| field.name == name);
            let at = field.expect("a field").offset;
            memory[at..at + bytes.len()].copy_from_slice(bytes);
        }
        memory
    }

    fn sha256(number: u64) -> String {
        format!("{number:016x}{:048x}", 0)
    }

    fn status(hash: u64, offered_hash: u64) -> PolicyStatus {
        PolicyStatus {
            hash,
            offered_hash,
            ..PolicyStatus::default()
        }
    }

    fn names(files: Option<Policies>) -> Vec<String> {
        let mut names: Vec<_> = files
            .expect("a status")
            .into_iter()
            .map(|of| of.0)
            .collect();
        names.sort_unstable();
        names
    }

    #[test]
    fn the_file_in_use_stays_however_many_are_offered() {
        let first: Arc<[u8]> = [1].into();
        let mut offers = Offers::new(vec![(sha256(1), first)]);
        for number in 2..=20 {
            offers.keep(sha256(number), &[number as u8]);
        }
        assert_eq!(offers.files.len(), 1 + OFFERS_MAX);
        let used = offers.note_status(status(1, 20).as_bytes());
        assert_eq!(names(used), [sha256(1), sha256(20)]);
        // The offer is adopted, and given up for the one before it.
        let used = offers.note_status(status(20, 0).as_bytes());
        assert_eq!(names(used), [sha256(20)]);
        offers.keep(sha256(21), &[21]);
        let used = offers.note_status(status(1, 21).as_bytes());
        assert_eq!(names(used), [sha256(1), sha256(21)]);
    }

    #[test]
    fn an_offer_is_read_from_its_message() {
        let mut offers = Offers::new(Vec::new());
        let mut memory = offer([0xab; 32], b"policy");
        assert_eq!(offers.note_offer(&memory), Some("ab".repeat(32)));
        let expected: Policies = vec![("ab".repeat(32), Arc::from(&b"policy"[..]))];
        assert_eq!(offers.files, expected);
        // More than a message holds.
        let field = Weights::FIELDS
            .iter()
            .find(|field| field.name == "byte_count");
        let at = field.expect("a field").offset;
        memory[at..at + 8].fill(0xff);
        assert_eq!(offers.note_offer(&memory), None);
        assert_eq!(offers.note_offer(&memory[..100]), None);
        assert_eq!(offers.files, expected);
    }
}
