use std::io::Write;
use std::process::Command;
use std::sync::Arc;

use shm_config::message::Step;
use shm_config::services::{STEP, WEIGHTS};
use tempfile::TempDir;

use super::*;
use crate::Recording;
use crate::process::policies::tests::offer;
use crate::schema::ENCAPSULATION;
use crate::write::Stamp;

fn files(folder: &Path, bytes_max: u64) -> Files {
    let storage = Storage {
        folder: folder.into(),
        root: folder.into(),
        bytes_max,
    };
    let channels = vec![Channel::of(&STEP.row, STEP.name)];
    Files::new(storage, Origin::default(), channels, Enclosed::default())
}

/// Bytes that do not compress.
fn noise(sequence: u64) -> Vec<u8> {
    let mut state = sequence.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32) as u8
    };
    let body = (0..size_of::<Step>()).map(|_| next());
    ENCAPSULATION.into_iter().chain(body).collect()
}

fn take(files: &mut Files, sequence: u64, now: Instant) {
    let stamp = Stamp {
        recorded_ns: now.0,
        taken_ns: now.0,
        sequence,
    };
    files.take(Label { channel: 0, stamp }, &noise(sequence), now);
    files.advance(now, Losses::default);
}

#[test]
fn a_new_file_begins_each_minute_and_the_oldest_goes_at_the_limit() {
    let folder = tempfile::tempdir().expect("a folder");
    let limit = 8 << 20;
    let mut files = files(folder.path(), limit);
    // A second from step to step: 20 minutes, 14 MB.
    for second in 1..=1200 {
        take(&mut files, second, Instant(second * 1_000_000_000));
    }
    files.finish(Instant(0), Losses::default());
    assert!(files.losses().is_empty());
    assert!(files.files >= 19, "{} files", files.files);
    let kept = fs::read_dir(folder.path()).expect("the folder").flatten();
    let bytes: u64 = kept
        .map(|entry| entry.metadata().map_or(0, |file| file.len()))
        .sum();
    assert!(bytes <= limit && bytes > limit / 2, "{bytes} bytes");
    let recording = Recording::open(folder.path()).expect("readable");
    let steps: Vec<_> = recording
        .entries()
        .map(|entry| entry.expect("whole"))
        .collect();
    assert_eq!(
        steps.last().map(|entry| entry.taken_ns),
        Some(1200 * 1_000_000_000)
    );
    assert!(
        steps.len() > 300 && steps.len() < 1200,
        "the oldest are gone"
    );
    assert_eq!(steps[0].bytes().len(), size_of::<Step>());
}

#[test]
fn a_disk_that_refuses_is_tried_again_and_what_it_missed_is_counted() {
    let above = tempfile::tempdir().expect("a folder");
    let folder = above.path().join("missing");
    let mut files = files(&folder, 1 << 30);
    let second = |second: u64| Instant(second * 1_000_000_000);
    for now in 1..=4 {
        take(&mut files, now, second(now));
    }
    assert_eq!(
        files.losses().to_string(),
        "step: queue 0, memory 0, disk 4"
    );
    fs::create_dir(&folder).expect("a folder");
    for now in 5..=9 {
        take(&mut files, now, second(now));
    }
    let mut before = Losses::default();
    before.add("plan", Lost::Queue, 3);
    files.finish(second(10), before);
    let recording = Recording::open(&folder).expect("readable");
    let there = recording.entries().count() as u64;
    assert!(there >= 4, "{there}");
    assert_eq!(there, files.count);
    assert_eq!(there + files.losses().total(), 9);
    let lost: Vec<_> = recording.lost().collect();
    assert_eq!(
        lost,
        [
            ("plan", "queue 3, memory 0, disk 0"),
            ("step", "queue 0, memory 0, disk 4")
        ]
    );
}

/// A disk of one megabyte, which is unmounted also when a test panics.
struct SmallDisk(TempDir);

impl SmallDisk {
    /// `None` where no file system can be mounted.
    fn mount() -> Option<Self> {
        let folder = tempfile::tempdir().expect("a folder");
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", "size=1m", "tmpfs"])
            .arg(folder.path())
            .output();
        match mounted.is_ok_and(|output| output.status.success()) {
            true => Some(Self(folder)),
            false => None,
        }
    }

    fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let unmounted = Command::new("umount").arg(self.path()).status();
        let is_unmounted = unmounted.is_ok_and(|status| status.success());
        // A panic within a panic would end the program.
        assert!(is_unmounted || std::thread::panicking(), "still mounted");
    }
}

#[test]
fn a_full_disk_loses_what_is_counted_and_nothing_else() {
    let Some(disk) = SmallDisk::mount() else {
        let why = "skipped: a full disk: no file system can be mounted here";
        let _ = writeln!(std::io::stderr(), "{why}");
        return;
    };
    let mut files = files(disk.path(), 1 << 30);
    for tick in 1..=1000 {
        take(&mut files, tick, Instant(tick * 100_000_000));
    }
    files.finish(Instant(0), Losses::default());
    let left = fs::read_dir(disk.path()).map_or(0, Iterator::count);
    let recording = Recording::open(disk.path());
    let there = recording.map(|recording| recording.entries().filter(Result::is_ok).count());
    let (count, lost) = (files.count, files.losses().total());
    assert_eq!(count + lost, 1000);
    // It is tried again 45 times.
    assert!(left <= 3, "{left} files");
    assert!(lost > 500, "{lost} lost");
    let there = there.expect("readable") as u64;
    assert!(
        there >= count && there > 50,
        "{there} there, {count} counted as written"
    );
}

#[test]
fn a_policy_file_is_attached_where_its_offer_is_not() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut files = files(folder.path(), 64 << 20);
    files.channels = vec![Channel::of(&WEIGHTS.row, WEIGHTS.name)];
    let memory = offer([0xab; 32], b"policy");
    let cdr: Vec<u8> = ENCAPSULATION.into_iter().chain(memory).collect();
    let label = Label {
        channel: 0,
        stamp: Stamp {
            recorded_ns: 1,
            taken_ns: 1,
            sequence: 1,
        },
    };
    let sha256 = "ab".repeat(32);
    let used: Policies = vec![(sha256.clone(), Arc::from(&b"policy"[..]))];
    let attached = || {
        let recording = Recording::open(folder.path()).expect("readable");
        let names = recording
            .attachments()
            .filter(|file| file.name == format!("{POLICIES}{sha256}"));
        let policy = recording.policy(0xabab_abab_abab_abab).expect("readable");
        (names.count(), policy)
    };
    let expected = Some(b"policy".to_vec());
    // The offer is in the first file, and in use when the second begins.
    files.take(label, &cdr, Instant(0));
    files.note_offer(sha256.clone());
    files.enclose(used.clone());
    files.finish(Instant(0), Losses::default());
    assert_eq!(attached(), (0, expected.clone()));
    files.take(label, &cdr, Instant(1));
    files.finish(Instant(1), Losses::default());
    assert_eq!(attached(), (1, expected.clone()));
    // The third file has no offer when the policy is used.
    files.enclose(Vec::new());
    files.take(label, &cdr, Instant(2));
    files.enclose(used);
    files.finish(Instant(2), Losses::default());
    assert_eq!(attached(), (2, expected));
}
