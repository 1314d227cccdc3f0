//! Tests that the replay on disk survives the end of its process.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use learner::assembler::Counts;
use learner::journal::{Journal, Mark, Recovered, last_mark};
use learner::replay::{Buffer, INPUTS, Replay, Then, Transition};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use shm_config::message::Preference;
use tempfile::TempDir;

/// Bytes before the first record.
const MAGIC: usize = 8;
/// The variable that names the file of a child of this test.
const CHILD: &str = "VLAPS_TEST_JOURNAL";
/// Capacity of each buffer in these tests, transitions.
const CAPACITY: usize = 4;

/// A transition made from a number, which is its first feature.
fn numbered(number: u64) -> Transition {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(number);
    let mut pair = || {
        [
            random.random_range(-1.0..1.0),
            random.random_range(-1.0..1.0),
        ]
    };
    let (applied, policy, expert) = (pair(), pair(), pair());
    let mut state = [0.0; INPUTS];
    let mut next = [0.0; INPUTS];
    for value in state.iter_mut().chain(&mut next) {
        *value = random.random();
    }
    state[0] = number as f32;
    Transition {
        state,
        next,
        applied,
        policy,
        expert,
        label: [Preference::Abstain, Preference::Expert, Preference::Policy][number as usize % 3],
        then: [Then::On, Then::End, Then::Unknown][number as usize / 3 % 3],
    }
}

fn buffer(number: u64) -> Buffer {
    match number % 5 {
        4 => Buffer::Predicted,
        _ => numbered(number).buffer(),
    }
}

fn mark(number: u64) -> Mark {
    Mark {
        counts: Counts {
            steps: number,
            lost: 2 * number,
            unseen: 3 * number,
            cut: 4 * number,
            expert: 5 * number,
            policy: 6 * number,
            unlabelled: 7 * number,
            interventions: 8 * number,
            imagined: 12 * number,
        },
        producer: 9 + number as u32,
        sequence: 10 * number,
        updates: 11 * number,
    }
}

fn append(journal: &mut Journal, replay: &mut Replay, number: u64) {
    let transition = numbered(number);
    let done = journal.append(buffer(number), &transition, &mark(number));
    done.expect("written");
    replay.push(buffer(number), transition);
}

fn open(path: &Path) -> Recovered {
    Journal::open(path, CAPACITY, 0).expect("a journal")
}

/// Writes a file with this many transitions; returns its bytes.
fn written(path: &Path, count: u64) -> Vec<u8> {
    let mut journal = open(path).journal;
    let mut replay = Replay::new(CAPACITY);
    for number in 0..count {
        append(&mut journal, &mut replay, number);
    }
    journal.flush().expect("written");
    drop(journal);
    fs::read(path).expect("the file")
}

fn assert_holds(replay: &Replay, count: u64, what: &str) {
    let mut expected = Replay::new(CAPACITY);
    for number in 0..count {
        expected.push(buffer(number), numbered(number));
    }
    assert_same(replay, &expected, what);
}

fn assert_same(replay: &Replay, expected: &Replay, what: &str) {
    for buffer in Buffer::ALL {
        let equal = replay.iter(buffer).eq(expected.iter(buffer));
        assert!(equal, "{what}: {buffer:?} differs");
    }
}

#[test]
fn a_file_gives_back_what_was_written() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    let first = open(&path);
    assert!(first.mark.is_none() && first.replay.is_empty() && first.torn_bytes == 0);
    drop(first);
    for count in [1, 3, 30] {
        let _ = fs::remove_file(&path);
        written(&path, count);
        let found = open(&path);
        assert_holds(&found.replay, count, "reopened");
        assert_eq!(found.mark, Some(mark(count - 1)));
        assert_eq!(found.torn_bytes, 0);
    }
}

#[test]
fn the_last_mark_is_read_before_an_incomplete_record() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    assert_eq!(last_mark(&path).expect("no file is no mark"), None);
    let bytes = written(&path, 3);
    assert_eq!(last_mark(&path).expect("a file"), Some(mark(2)));
    fs::write(&path, &bytes[..bytes.len() - 1]).expect("a file");
    assert_eq!(last_mark(&path).expect("a file"), Some(mark(1)));
    let length = fs::metadata(&path).expect("the file").len();
    assert_eq!(length, bytes.len() as u64 - 1, "left as it is");
}

#[test]
fn appending_goes_on_after_reopening() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    for number in 0..12 {
        let Recovered {
            mut journal,
            mut replay,
            ..
        } = open(&path);
        assert_holds(&replay, number, "before");
        append(&mut journal, &mut replay, number);
        // The journal is dropped without a flush: dropping writes the rest.
    }
    assert_holds(&open(&path).replay, 12, "after");
}

#[test]
fn a_record_torn_anywhere_is_cut_off_and_the_rest_kept() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    let bytes = written(&path, 3);
    let record = (bytes.len() - MAGIC) / 3;
    assert_eq!(MAGIC + 3 * record, bytes.len());
    for kept in 0..record {
        let length = MAGIC + 2 * record + kept;
        fs::write(&path, &bytes[..length]).expect("a file");
        let what = format!("{kept} bytes of the last record");
        let found = open(&path);
        assert_eq!(found.torn_bytes, kept as u64, "{what}");
        assert_eq!(found.mark, Some(mark(1)), "{what}");
        assert_holds(&found.replay, 2, &what);
        let Recovered {
            mut journal,
            mut replay,
            ..
        } = found;
        append(&mut journal, &mut replay, 2);
        drop(journal);
        assert_eq!(fs::read(&path).expect("the file"), bytes, "{what}");
    }
}

#[test]
fn a_flipped_byte_ends_the_file_there() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    let bytes = written(&path, 3);
    let record = (bytes.len() - MAGIC) / 3;
    let offsets = (0..record).step_by(13).chain(record - 110..record);
    for offset in offsets {
        let mut bad = bytes.clone();
        bad[MAGIC + record + offset] ^= 0x10;
        fs::write(&path, &bad).expect("a file");
        let what = format!("byte {offset} of the second record");
        let found = open(&path);
        assert_holds(&found.replay, 1, &what);
        assert_eq!(found.mark, Some(mark(0)), "{what}");
        assert_eq!(found.torn_bytes, 2 * record as u64, "{what}");
        drop(found);
        assert_eq!(
            fs::metadata(&path).expect("the file").len(),
            (MAGIC + record) as u64
        );
    }
}

#[test]
fn a_file_of_another_kind_is_refused_and_unchanged() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    let mut other_version = written(&path, 2);
    other_version[MAGIC - 1] ^= 1;
    for foreign in [
        &b"hello"[..],
        b"VLX",
        b"a text that is longer",
        &other_version,
    ] {
        fs::write(&path, foreign).expect("a file");
        let error = Journal::open(&path, CAPACITY, 0).err().expect("a refusal");
        assert!(
            error.to_string().contains("no replay of this version"),
            "{error}"
        );
        assert_eq!(fs::read(&path).expect("the file"), foreign);
        let error = last_mark(&path).expect_err("a refusal").to_string();
        assert!(error.contains("no replay of this version"), "{error}");
    }
    fs::write(&path, b"VLREPL01 and records").expect("a file");
    let error = Journal::open(&path, CAPACITY, 0).err().expect("a refusal");
    let words = "it has version 01, this build reads version 03";
    assert!(error.to_string().contains(words), "{error}");
}

#[test]
fn a_counter_that_no_run_reaches_is_damage() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    let bytes = written(&path, 3);
    let record = (bytes.len() - MAGIC) / 3;
    // Twelve counters before the checksum.
    for counter in 0..12 {
        let mut crafted = bytes.clone();
        let (body, sum) = crafted[MAGIC + 2 * record..].split_at_mut(record - 4);
        let at = body.len() - 8 * (12 - counter);
        body[at..at + 8].copy_from_slice(&u64::MAX.to_le_bytes());
        sum.copy_from_slice(&crc32fast::hash(body).to_le_bytes());
        fs::write(&path, &crafted).expect("a file");
        assert_eq!(
            last_mark(&path).expect("a file"),
            Some(mark(1)),
            "{counter}"
        );
        assert_holds(&open(&path).replay, 2, "the others");
    }
}

#[test]
fn a_file_whose_beginning_was_torn_begins_anew() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    let bytes = written(&path, 0);
    assert_eq!(bytes.len(), MAGIC);
    for length in 0..MAGIC {
        fs::write(&path, &bytes[..length]).expect("a file");
        drop(open(&path));
        assert_eq!(fs::read(&path).expect("the file"), bytes, "{length} bytes");
    }
}

#[test]
fn compaction_keeps_what_the_buffers_hold() {
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    let Recovered {
        mut journal,
        mut replay,
        ..
    } = open(&path);
    let mut lengths = Vec::new();
    for number in 0..200 {
        append(&mut journal, &mut replay, number);
        journal.flush().expect("written");
        journal
            .compact(&replay, &mark(number), &mut || {})
            .expect("written");
        lengths.push(fs::metadata(&path).expect("the file").len());
        let found = Journal::open(&path, CAPACITY, 0).expect("a journal");
        assert_same(&found.replay, &replay, &format!("after {number}"));
        assert_eq!(found.mark, Some(mark(number)));
    }
    let shorter = lengths.windows(2).filter(|pair| pair[1] < pair[0]).count();
    assert!(shorter > 3, "it was never written anew: {lengths:?}");
    let names = fs::read_dir(folder.path()).expect("the folder").count();
    assert_eq!(names, 1, "nothing else is left in the folder");
}

#[test]
fn a_long_compaction_says_that_it_lives() {
    const LARGE: usize = 2500;
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    let Recovered {
        mut journal,
        mut replay,
        ..
    } = Journal::open(&path, LARGE, 0).expect("a journal");
    for number in 0..=6 * LARGE as u64 {
        append(&mut journal, &mut replay, number);
    }
    let mut beats = 0;
    journal
        .compact(&replay, &mark(6 * LARGE as u64), &mut || beats += 1)
        .expect("written");
    let held: usize = Buffer::ALL.iter().map(|&buffer| replay.len(buffer)).sum();
    assert!(held > 2048, "{held} transitions");
    assert_eq!(beats, held / 2048);
}

#[test]
fn compaction_that_fails_leaves_the_file() {
    let folder = TempDir::new().expect("a folder");
    let inner = folder.path().join("inner");
    fs::create_dir(&inner).expect("a folder");
    let path = inner.join("replay.bin");
    let Recovered {
        mut journal,
        mut replay,
        ..
    } = open(&path);
    for number in 0..60 {
        append(&mut journal, &mut replay, number);
    }
    journal.flush().expect("written");
    // No file can be created where there is no folder.
    let aside = folder.path().join("aside");
    fs::rename(&inner, &aside).expect("moved");
    journal
        .compact(&replay, &mark(59), &mut || {})
        .expect_err("no folder");
    append(&mut journal, &mut replay, 60);
    drop(journal);
    let found = open(&aside.join("replay.bin"));
    assert_same(&found.replay, &replay, "the old file, open still");
    assert_eq!(found.mark, Some(mark(60)));
}

/// Appends and compacts until it is killed, and reports each number that is on disk.
fn append_for_ever(path: &Path) -> ! {
    let Recovered {
        mut journal,
        mut replay,
        ..
    } = open(path);
    let mut said = std::io::stderr();
    for number in 0.. {
        append(&mut journal, &mut replay, number);
        journal.flush().expect("written");
        journal
            .compact(&replay, &mark(number), &mut || {})
            .expect("written");
        writeln!(said, "{number}").expect("the parent reads");
    }
    unreachable!("the parent kills this process")
}

#[test]
fn a_process_killed_at_any_instant_leaves_a_whole_file() {
    const NAME: &str = "journal::a_process_killed_at_any_instant_leaves_a_whole_file";
    if let Some(path) = std::env::var_os(CHILD) {
        append_for_ever(Path::new(&path));
    }
    let folder = TempDir::new().expect("a folder");
    let path = folder.path().join("replay.bin");
    let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
    for round in 0..12 {
        let _ = fs::remove_file(&path);
        // Every 25th append compacts; the child is killed around one of these.
        let until: u64 = 22 + 21 * random.random_range(0..4) + random.random_range(0..5);
        let mut child = Command::new(std::env::current_exe().expect("this test"))
            .args(["--exact", NAME, "--nocapture"])
            .env(CHILD, &path)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("a child");
        let mut lines = BufReader::new(child.stderr.take().expect("a pipe")).lines();
        let heard = lines.by_ref().find_map(|line| {
            let number: u64 = line.ok()?.parse().ok()?;
            (number >= until).then_some(number)
        });
        child.kill().expect("it lives");
        child.wait().expect("it ends");
        let what = format!("seed 5, round {round}, killed after {until}");
        let heard = heard.unwrap_or_else(|| panic!("{what}: the child ended by itself"));
        let found = open(&path);
        // Every record that was reported must be there; more may be.
        let reached = found.mark.expect("a mark").counts.steps;
        assert!(reached >= heard, "{what}: {reached} of {heard}");
        assert_holds(&found.replay, reached + 1, &what);
    }
}
