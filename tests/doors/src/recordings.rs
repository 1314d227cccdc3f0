//! Files of recordings, and what viewers send.

use recorder::Recording;
use shm_config::services::{OBSERVATION, STEP};
use view::live::foxglove::{Board, take_all};

use crate::Said;

/// A file of a recording: it is refused, or all of it is read and counted.
pub fn recording(bytes: &[u8]) -> Said {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("run-0001.mcap"), bytes).expect("a file");
    let Ok(recording) = Recording::open(folder.path()) else {
        return Said::Refused;
    };
    let _ = recording.verify();
    let _ = recording.span_ns();
    let _ = recording.lost().count();
    let _ = recording.configuration();
    for attachment in recording.attachments() {
        let _ = recording.data(attachment);
    }
    let mut messages = 0;
    for entry in recording.entries().flatten() {
        let _ = (entry.header(), entry.recorded_ns(recording.origin()));
        messages += usize::from(entry.read(&STEP).is_some() || entry.read(&OBSERVATION).is_some());
    }
    if let Ok(later) = recording.entries().from_tick(7) {
        let _ = later.count();
    }
    Said::of(messages > 0)
}

/// What a client of the viewers' port sends after the handshake: the connection is closed,
/// or its subscriptions are within their limit.
pub fn viewer(bytes: &[u8]) -> Said {
    let Ok((subscriptions, _)) = take_all(bytes, &Board::default()) else {
        return Said::Refused;
    };
    assert!(subscriptions <= 256, "{subscriptions} subscriptions");
    Said::of(subscriptions > 0)
}
