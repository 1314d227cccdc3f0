//! Files that are written while a set drives and read when it drives again.

use std::path::Path;

use gate::judge::Recorded;
use gate::record::store;
use judge::audit;
use learner::checkpoint::{Checkpoint, MAGIC};
use learner::journal::{Journal, last_mark};

use crate::Said;

/// Capacity of a replay buffer in this target, transitions.
const CAPACITY: usize = 64;
/// Bytes of a journal's first line, and of a checkpoint's.
const MAGIC_BYTES: usize = 8;

/// The lines of a judge's records: an error names the number of a broken line, and the
/// other records can be shown and replayed.
pub fn records(bytes: &[u8]) -> Said {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join(store::QUESTIONS);
    std::fs::write(&path, bytes).expect("a file");
    let Ok(records) = store::read(folder.path()) else {
        return Said::Refused;
    };
    Recorded::new(&records.questions);
    let page = audit::page(&records, 4, Path::new(".")).html;
    assert!(page.starts_with("<!DOCTYPE html>"));
    // Further records are appended after a complete line.
    let mut open = store::Store::open(folder.path(), 1 << 20).expect("a store");
    let next = open.begin(records.questions[0].clone(), &[]);
    open.complete(next);
    store::read(folder.path()).expect("still records");
    Said::Admitted
}

/// A learner's journal, complete or not. With an odd first byte, the records get a
/// valid checksum.
pub fn journal(bytes: &[u8]) -> Said {
    let Some((choice, rest)) = bytes.split_first() else {
        return Said::Refused;
    };
    let mut file = rest.to_vec();
    if choice % 2 == 1 {
        for record in file
            .get_mut(MAGIC_BYTES..)
            .into_iter()
            .flat_map(|body| body.chunks_exact_mut(learner::journal::RECORD))
        {
            let (body, sum) = record.split_at_mut(learner::journal::RECORD - 4);
            sum.copy_from_slice(&crc32fast::hash(body).to_le_bytes());
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("replay.bin");
    std::fs::write(&path, &file).expect("a file");
    let marked = last_mark(&path);
    let Ok(recovered) = Journal::open(&path, CAPACITY, 0) else {
        return Said::Refused;
    };
    marked.expect("a file that opens can be read");
    drop(recovered.journal);
    // An incomplete record is cut off, so the reopened journal is complete.
    let again = Journal::open(&path, CAPACITY, 0).expect("as it was left");
    assert_eq!(again.torn_bytes, 0);
    assert_eq!(again.mark, recovered.mark);
    Said::of(recovered.mark.is_some())
}

/// A learner's networks. The checksum is made valid, so that the code behind its check
/// is reached.
pub fn checkpoint(bytes: &[u8]) -> Said {
    let mut file = MAGIC.to_vec();
    file.extend_from_slice(&crc32fast::hash(bytes).to_le_bytes());
    file.extend_from_slice(bytes);
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("learner.bin");
    std::fs::write(&path, &file).expect("a file");
    let Ok(Some(state)) = Checkpoint::read(&path) else {
        return Said::Refused;
    };
    let _ = state.student.begun_with();
    let net = state.student.policy();
    let mut tape = learner::Tape::default();
    net.forward(&vec![0.5; net.inputs()], 1, &mut tape);
    Said::Admitted
}
