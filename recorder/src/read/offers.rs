//! The policy files in messages of `weights`: those that were offered during the run.

use std::collections::BTreeMap;

use shm_config::layout::Layout;
use shm_config::message::Weights;
use shm_config::services::WEIGHTS;

use super::Recording;

/// SHA-256 and bytes of the policy file of an offer, whose `memory` is that of [`Weights`];
/// `None` if it is shorter than it says.
pub(crate) fn offered(memory: &[u8]) -> Option<(&[u8], &[u8])> {
    let field = |name: &str| {
        let field = Weights::FIELDS.iter().find(|field| field.name == name)?;
        memory.get(field.offset..field.offset + field.size)
    };
    let count = u64::from_le_bytes(field("byte_count")?.try_into().ok()?);
    let file = field("bytes")?.get(..usize::try_from(count).ok()?)?;
    Some((field("sha256")?, file))
}

/// The first eight bytes of a SHA-256.
fn begin(sha256: &[u8]) -> Option<u64> {
    sha256.first_chunk().copied().map(u64::from_be_bytes)
}

/// When the offer of each policy file was recorded first, on the run's clock, ns, by the first
/// eight bytes of its SHA-256. An offer in a damaged chunk is left out.
pub(super) fn times(recording: &Recording) -> BTreeMap<u64, u64> {
    let mut times = BTreeMap::new();
    for entry in recording.entries_of([WEIGHTS.name]).flatten() {
        if let Some(hash) = offered(entry.bytes()).and_then(|(sha256, _)| begin(sha256)) {
            let recorded_ns = entry.recorded_ns(recording.origin());
            times.entry(hash).or_insert(recorded_ns);
        }
    }
    times
}

/// The policy file whose SHA-256 begins with these eight bytes, offered at this time or later.
pub(super) fn find(recording: &Recording, hash: u64, recorded_ns: u64) -> Option<Vec<u8>> {
    let offers = recording.entries_of([WEIGHTS.name]).from_ns(recorded_ns);
    offers.flatten().find_map(|entry| {
        let (sha256, file) = offered(entry.bytes())?;
        (begin(sha256) == Some(hash)).then(|| file.to_vec())
    })
}
