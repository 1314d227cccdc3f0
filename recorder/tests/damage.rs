//! What is wrong with a file is told in one line, and the rest of it is read.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::Path;

use mcap::records::Metadata;
use recorder::{Origin, Recording, RecordingError, Writer};
use shm_config::message::Step;
use shm_config::services::STEP;

const STEPS: u64 = 30;

fn step(tick: u64) -> Step {
    let mut step = Step::default();
    step.header.tick = tick;
    step.command.pedal = 1.0 / (tick + 1) as f64;
    step
}

/// Chunks of ten steps. Without `finish` it is the file of a killed recorder.
fn write(path: &Path, finish: bool) {
    let mut writer = Writer::create(path, &Origin::default()).expect("a file");
    writer
        .attach("config.toml", "application/toml", b"[run]\n")
        .expect("attached");
    for tick in 0..STEPS {
        writer.write(&STEP, tick + 1, &step(tick)).expect("written");
        if tick % 10 == 9 {
            writer.flush().expect("flushed");
        }
    }
    writer
        .write(&STEP, STEPS + 1, &step(STEPS))
        .expect("written");
    match finish {
        true => drop(writer.finish().expect("finished")),
        // As SIGKILL: what was not handed to the system is lost.
        false => std::mem::forget(writer),
    }
}

/// The steps that can be read, and the errors, each in one line.
fn read(path: &Path) -> Result<(Vec<Step>, Vec<String>), RecordingError> {
    let recording = Recording::open(path)?;
    let (mut steps, mut errors) = (Vec::new(), Vec::new());
    for step in recording.messages(&STEP)? {
        match step {
            Ok(step) => steps.push(step),
            Err(error) => errors.push(error.to_string()),
        }
    }
    errors.extend(recording.damage().map(String::from));
    Ok((steps, errors))
}

fn is_one_line(text: &str) -> bool {
    !text.contains('\n') && text.len() < 400
}

#[test]
fn the_file_of_a_killed_recorder_is_read_to_its_last_chunk() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("killed.mcap");
    write(&path, false);
    let (steps, errors) = read(&path).expect("readable");
    assert_eq!(steps, (0..STEPS).map(step).collect::<Vec<_>>());
    assert_eq!(errors.len(), 1, "{errors:?}");
    assert!(
        errors[0].contains("killed.mcap: ends at byte"),
        "{errors:?}"
    );
    let recording = Recording::open(&path).expect("readable");
    let text = recording.configuration().expect("readable");
    assert_eq!(text.as_deref(), Some("[run]\n"));
    let count = recording.counts()["step"];
    let spans = (count.messages, count.first_log_ns, count.last_log_ns);
    assert_eq!(spans, (STEPS, 1, STEPS));
}

#[test]
fn a_file_cut_anywhere_gives_its_beginning_or_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("whole.mcap");
    write(&path, true);
    let whole = fs::read(&path).expect("readable");
    let cut = folder.path().join("cut.mcap");
    let mut partly = 0;
    // An odd stride meets every part of a record.
    for length in (0..whole.len()).step_by(37).chain([whole.len() - 1]) {
        fs::write(&cut, &whole[..length]).expect("written");
        match read(&cut) {
            Ok((steps, errors)) => {
                let expected: Vec<_> = (0..steps.len() as u64).map(step).collect();
                assert_eq!(steps, expected, "cut at {length}");
                // Within the eight bytes that close a file nothing is missing.
                let is_cut = length + 8 < whole.len();
                assert!(!errors.is_empty() || !is_cut, "cut at {length}");
                assert!(errors.iter().all(|error| is_one_line(error)), "{errors:?}");
                partly += usize::from(!steps.is_empty());
                let counts = Recording::open(&cut).expect("readable").counts();
                let counted = counts.get("step").map_or(0, |count| count.messages);
                assert_eq!(counted, steps.len() as u64, "cut at {length}");
            }
            Err(error) => {
                let error = error.to_string();
                assert!(is_one_line(&error) && error.contains("cut.mcap"), "{error}");
            }
        }
    }
    assert!(partly > 5, "some cuts leave steps: {partly}");
}

#[test]
fn a_flipped_bit_is_never_read_as_a_message() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("whole.mcap");
    write(&path, true);
    let whole = fs::read(&path).expect("readable");
    let flipped = folder.path().join("flipped.mcap");
    let mut found = 0;
    for at in (8..whole.len()).step_by(53) {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at % 8);
        fs::write(&flipped, &bytes).expect("written");
        match read(&flipped) {
            Ok((steps, errors)) => {
                for read in steps {
                    let expected = step(read.header.tick);
                    assert_eq!(read, expected, "byte {at}");
                }
                assert!(errors.iter().all(|error| is_one_line(error)), "{errors:?}");
                found += usize::from(!errors.is_empty());
            }
            Err(error) => {
                assert!(is_one_line(&error.to_string()), "{error}");
                found += 1;
            }
        }
    }
    assert!(found > 10, "some bits are in chunks: {found}");
}

#[test]
fn foreign_files_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let refused = |name: &str, content: &[u8], expected: &str| {
        let path = folder.path().join(name);
        fs::write(&path, content).expect("written");
        let error = Recording::open(&path).expect_err(name).to_string();
        assert!(is_one_line(&error) && error.contains(name), "{error}");
        assert!(error.contains(expected), "{error}");
    };
    refused("empty.mcap", b"", "has 0 bytes");
    refused("text.mcap", b"no recording at all", "it is no MCAP file");
    let bytes = std::io::Cursor::new(Vec::new());
    let mut other = mcap::Writer::new(bytes).expect("a writer");
    other.finish().expect("finished");
    let other = other.into_inner().into_inner();
    refused("other.mcap", &other, "no metadata 'vlaps.recording'");
    let missing = folder.path().join("missing.mcap");
    let error = Recording::open(&missing).expect_err("missing").to_string();
    assert!(error.contains("missing.mcap"), "{error}");
    let none = tempfile::tempdir().expect("a folder");
    let error = Recording::open(none.path()).expect_err("empty").to_string();
    assert!(error.contains("no file ending in .mcap"), "{error}");
}

#[test]
fn a_newer_format_is_refused_with_both_numbers() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("newer.mcap");
    let file = fs::File::create(&path).expect("a file");
    let mut writer = mcap::Writer::new(std::io::BufWriter::new(file)).expect("a writer");
    let facts = [
        ("format", "2"),
        ("run", "a"),
        ("session", "b"),
        ("lockstep", "0"),
        ("epoch_offset_ns", "0"),
    ];
    let metadata: BTreeMap<_, _> = facts
        .iter()
        .map(|(key, value)| (key.to_string(), value.to_string()))
        .collect();
    let name = "vlaps.recording".into();
    writer
        .write_metadata(&Metadata { name, metadata })
        .expect("written");
    writer.finish().expect("finished");
    let error = Recording::open(&path).expect_err("newer").to_string();
    assert!(error.contains("format 2, this binary reads 1"), "{error}");
}

#[test]
fn another_layout_and_several_runs_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("layout.mcap");
    let mut writer = Writer::create(&path, &Origin::default()).expect("a file");
    let mut channel = recorder::Channel::named("step").expect("a service");
    channel.service = "step_of_another_build".into();
    writer.channel(&channel).expect("a channel");
    writer.finish().expect("finished");
    let service = shm_config::services::Service::<Step>::custom(
        "step_of_another_build",
        shm_config::services::Process::Controller,
        &[],
        shm_config::services::Delivery::Latest,
    );
    assert!(
        Recording::open(&path)
            .expect("readable")
            .messages(&service)
            .is_ok()
    );
    channel.layout = "0123456789abcdef".into();
    let mut writer = Writer::create(&path, &Origin::default()).expect("a file");
    writer.channel(&channel).expect("a channel");
    writer.finish().expect("finished");
    let refused = Recording::open(&path).expect("readable").messages(&service);
    let Err(error) = refused else {
        panic!("another layout is read");
    };
    let error = error.to_string();
    assert!(error.contains("layout 0123456789abcdef"), "{error}");
    let session = "2".to_string();
    let other = Origin {
        session,
        ..Origin::default()
    };
    let second = folder.path().join("second.mcap");
    Writer::create(&second, &other)
        .expect("a file")
        .finish()
        .expect("finished");
    let error = Recording::open(folder.path())
        .expect_err("two runs")
        .to_string();
    assert!(error.contains("recordings of 2 runs"), "{error}");
}

/// A length is checked before memory is taken for it; the file has holes.
#[test]
fn a_chunk_of_any_length_is_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("long.mcap");
    write(&path, false);
    let at = fs::metadata(&path).expect("there").len();
    let length = 1_u64 << 40;
    let mut file = fs::File::options().append(true).open(&path).expect("there");
    // A chunk without messages, so that it is read as the file is opened.
    file.write_all(&[mcap::records::op::CHUNK])
        .expect("written");
    file.write_all(&length.to_le_bytes()).expect("written");
    file.set_len(at + 9 + length).expect("a file with holes");
    let error = read(&path).expect_err("damaged").to_string();
    assert!(is_one_line(&error), "{error}");
    assert!(
        error.contains("1099511627776 bytes are more than"),
        "{error}"
    );
}
