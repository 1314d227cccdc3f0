//! What is written while a set drives, and read when it drives again.

use std::path::Path;

use gate::judge::Recorded;
use gate::record::store;
use judge::audit;
use learner::checkpoint::Checkpoint;
use learner::journal::{Journal, last_mark};

use crate::Said;

/// Transitions in a ring of the target's replay.
const CAPACITY: usize = 64;
/// Bytes of a journal's first line, and of a checkpoint's.
const MAGIC_BYTES: usize = 8;

/// The lines of a judge's records: a broken line has its number, and the others
/// can be shown and replayed.
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
    // Who goes on writing does so after a whole line.
    let mut open = store::Store::open(folder.path(), 1 << 20).expect("a store");
    let next = open.begin(records.questions[0].clone(), &[]);
    open.complete(next);
    store::read(folder.path()).expect("still records");
    Said::Admitted
}

/// A learner's journal, torn or not. With the first byte odd, records get the
/// checksum that a writer would give them.
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
    last_mark(&path).expect("it can be read");
    let Ok(recovered) = Journal::open(&path, CAPACITY, 0) else {
        return Said::Refused;
    };
    drop(recovered.journal);
    // What is torn is cut off: opened again, it is whole.
    let again = Journal::open(&path, CAPACITY, 0).expect("as it was left");
    assert_eq!(again.torn_bytes, 0);
    assert_eq!(again.mark, recovered.mark);
    Said::of(recovered.mark.is_some())
}

/// A learner's networks; the checksum is that of the bytes, so that what is behind
/// it is reached.
pub fn checkpoint(bytes: &[u8]) -> Said {
    let mut file = b"VLLRNR02".to_vec();
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
