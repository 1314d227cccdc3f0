//! The folder of records: complete lines, bounded size, and a full disk.

use shm_config::message::Preference;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::Path;

use gate::presentation::{Party, Reply};
use gate::record::Record;
use gate::record::store::{PICTURES, QUESTIONS, QUESTIONS_BEFORE, ReadError, Store, read};

use crate::records::{SHOWING, asking, picture, record};

fn some_record() -> Record {
    let askings = vec![
        asking(SHOWING, Reply::First, 0.9),
        asking(SHOWING.swapped(), Reply::Second, 0.8),
    ];
    record(askings, Some(Preference::Expert), Party::Expert)
}

fn keep(store: &mut Store, count: u8) {
    for shade in 0..count {
        let question = store.begin(some_record(), &[picture(shade), picture(shade)]);
        store.complete(question);
    }
}

fn append(path: &Path, bytes: &[u8]) {
    let file = OpenOptions::new().append(true).open(path);
    file.and_then(|mut file| file.write_all(bytes))
        .expect("written");
}

fn size_of(folder: &Path) -> u64 {
    let files = fs::read_dir(folder).expect("a folder").flatten();
    files
        .map(|entry| {
            let data = entry.metadata().expect("a file");
            match data.is_dir() {
                true => size_of(&entry.path()),
                false => data.len(),
            }
        })
        .sum()
}

#[test]
fn what_was_written_is_read() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = Store::open(folder.path(), 1 << 20).expect("opens");
    let question = store.begin(some_record(), &[picture(1), picture(2)]);
    assert!(
        read(folder.path()).is_err(),
        "nothing before it is complete"
    );
    let open = store.record(question).expect("it waits");
    open.heard_tick = 77;
    store.complete(question);
    assert!(store.record(question).is_none());
    let records = read(folder.path()).expect("reads");
    let mut wanted = some_record();
    (wanted.question, wanted.heard_tick) = (1, 77);
    wanted.askings[0].picture = "pictures/000001-a.png".into();
    wanted.askings[1].picture = "pictures/000001-b.png".into();
    assert_eq!(records.questions, [wanted.clone()]);
    assert!(!records.is_torn);
    let bytes = fs::read(folder.path().join(&wanted.askings[1].picture)).expect("a file");
    assert_eq!(bytes, picture(2).bytes);
}

#[test]
fn the_end_of_a_run_writes_all_waiting_records() {
    let folder = tempfile::tempdir().expect("a folder");
    let inner = folder.path().join("judge");
    let mut store = Store::open(&inner, 1 << 20).expect("opens");
    store.begin(some_record(), &[]);
    store.begin(some_record(), &[]);
    drop(store);
    // The folder of the run can be given in place of its `judge` folder.
    let records = read(folder.path()).expect("reads");
    let numbers: Vec<u64> = records
        .questions
        .iter()
        .map(|record| record.question)
        .collect();
    assert_eq!((numbers, records.folder), (vec![1, 2], inner));
}

#[test]
fn a_torn_last_line_is_left_out_and_then_cut_off() {
    let folder = tempfile::tempdir().expect("a folder");
    keep(&mut Store::open(folder.path(), 1 << 20).expect("opens"), 2);
    append(&folder.path().join(QUESTIONS), b"{\"version\":1,\"questi");
    let records = read(folder.path()).expect("reads");
    assert_eq!((records.questions.len(), records.is_torn), (2, true));
    // A restarted gate appends a new line with the next number.
    keep(&mut Store::open(folder.path(), 1 << 20).expect("opens"), 1);
    let records = read(folder.path()).expect("reads");
    let numbers: Vec<u64> = records
        .questions
        .iter()
        .map(|record| record.question)
        .collect();
    assert_eq!((numbers, records.is_torn), (vec![1, 2, 3], false));
}

#[test]
fn a_line_that_is_no_record_is_named_by_its_number() {
    let folder = tempfile::tempdir().expect("a folder");
    keep(&mut Store::open(folder.path(), 1 << 20).expect("opens"), 2);
    let path = folder.path().join(QUESTIONS);
    append(&path, b"{\"version\": 1}\n");
    let error = read(folder.path()).expect_err("no record").to_string();
    assert!(
        error.contains("questions.jsonl, line 3: missing field"),
        "{error}"
    );
    fs::write(&path, "{\"version\": 3, \"news\": 1}\n").expect("written");
    let error = read(folder.path()).expect_err("newer").to_string();
    assert!(
        error.contains("line 1: format 3, this program knows 2"),
        "{error}"
    );
}

#[test]
fn no_record_is_a_clear_message() {
    let folder = tempfile::tempdir().expect("a folder");
    let error = read(folder.path()).expect_err("nothing there");
    assert!(matches!(error, ReadError::Nothing { .. }));
    assert!(
        error.to_string().contains("no record of a judge here"),
        "{error}"
    );
}

#[test]
fn the_folder_stays_within_its_bound_and_old_pictures_go_first() {
    let folder = tempfile::tempdir().expect("a folder");
    let bound = 40_000;
    let mut store = Store::open(folder.path(), bound).expect("opens");
    for shade in 0..200 {
        let question = store.begin(some_record(), &[picture(shade), picture(shade)]);
        store.complete(question);
        let size = size_of(folder.path());
        assert!(size <= bound, "{size} bytes after {shade}");
        assert_eq!(size, store.bytes(), "after {shade}");
    }
    assert_eq!(store.lost().lines, 0);
    let records = read(folder.path()).expect("reads");
    let first = records.questions.first().map(|record| record.question);
    let last = records.questions.last().map(|record| record.question);
    assert!(first > Some(1), "lines have gone, too: {first:?}");
    assert!(folder.path().join(QUESTIONS_BEFORE).is_file());
    assert_eq!(last, Some(200));
    let kept = fs::read_dir(folder.path().join(PICTURES)).expect("pictures");
    let mut names: Vec<String> = kept
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names.last().map(String::as_str), Some("000200-b.png"));
    assert!(names.len() > 20 && !names.contains(&"000001-a.png".to_string()));
}

#[test]
fn a_full_disk_is_counted_and_stops_no_run() {
    const WITHIN: &str = "VLAPS_TEST_NO_FILE_GROWS";
    if std::env::var_os(WITHIN).is_none() {
        // The same test in a process that may write no byte to a file.
        let limits = "trap '' XFSZ; ulimit -f 0; exec \"$0\" \"$@\"";
        let output = std::process::Command::new("sh")
            .args(["-c", limits])
            .arg(std::env::current_exe().expect("this program"))
            .args(["--exact", "store::a_full_disk_is_counted_and_stops_no_run"])
            .env(WITHIN, "1")
            .output()
            .expect("a shell");
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{said}");
        assert!(said.contains("1 passed"), "{said}");
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = Store::open(folder.path(), 1 << 20).expect("opens");
    keep(&mut store, 3);
    let lost = store.lost();
    assert_eq!((lost.lines, lost.pictures), (3, 6));
    assert!(lost.reason.contains("File too large"), "{}", lost.reason);
}

#[test]
fn a_link_in_place_of_the_lines_is_not_followed() {
    let folder = tempfile::tempdir().expect("a folder");
    let victim = folder.path().join("victim");
    fs::write(&victim, "precious, no line").expect("written");
    std::os::unix::fs::symlink(&victim, folder.path().join(QUESTIONS)).expect("a link");
    let error = Store::open(folder.path(), 1 << 20).expect_err("it is a link");
    assert!(error.to_string().contains("symbolic link"), "{error}");
    assert_eq!(
        fs::read_to_string(&victim).expect("there"),
        "precious, no line"
    );
}

#[test]
fn pictures_that_cannot_be_written_are_counted_and_the_line_is_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = Store::open(folder.path(), 1 << 20).expect("opens");
    fs::remove_dir(folder.path().join(PICTURES)).expect("removed");
    keep(&mut store, 1);
    assert_eq!((store.lost().lines, store.lost().pictures), (0, 2));
    let records = read(folder.path()).expect("reads");
    assert_eq!(records.questions[0].askings[0].picture, "");
}

#[test]
fn a_number_that_json_cannot_hold_is_counted_as_lost() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut store = Store::open(folder.path(), 1 << 20).expect("opens");
    let mut broken = some_record();
    broken.speed_mps = f64::NAN;
    let question = store.begin(broken, &[]);
    store.complete(question);
    keep(&mut store, 1);
    assert_eq!(store.lost().lines, 1);
    assert_eq!(read(folder.path()).expect("reads").questions.len(), 1);
}
