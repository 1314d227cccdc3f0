//! Every message type is read back byte for byte, in order, from a time and from a tick.

use std::path::Path;

use recorder::{Channel, Origin, Recording, Stamp, Writer, schema};
use shm_config::message::{Observation, Step};
use shm_config::services::{OBSERVATION, SERVICES, STEP};

const PERIOD_NS: u64 = 100_000_000;

fn origin() -> Origin {
    Origin {
        run: "test".into(),
        session: "1".into(),
        epoch_offset_ns: 1_700_000_000_000_000_000,
        facts: [("commit".to_string(), "abc".to_string())].into(),
        ..Origin::default()
    }
}

fn step(tick: u64) -> Step {
    let mut step = Step::default();
    step.header.tick = tick;
    step.header.taken_ns = tick * PERIOD_NS;
    step.header.sequence = tick + 1;
    step.command.steer = tick as f64;
    step
}

/// A file with an observation and a step for each of these ticks.
fn ticks(path: &Path, range: std::ops::Range<u64>) {
    let mut writer = Writer::create(path, &origin()).expect("a file");
    for tick in range {
        let mut observation = Observation::default();
        observation.header.tick = tick;
        let now_ns = tick * PERIOD_NS;
        writer
            .write(&OBSERVATION, now_ns, &observation)
            .expect("written");
        writer
            .write(&STEP, now_ns + 1, &step(tick))
            .expect("written");
        if tick % 10 == 9 {
            writer.flush().expect("flushed");
        }
    }
    writer.finish().expect("finished");
}

/// Numbers that differ from byte to byte, the same at each run.
fn noise(seed: u64, bytes: usize) -> Vec<u8> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32) as u8
    };
    (0..bytes).map(|_| next()).collect()
}

#[test]
fn every_message_type_returns_byte_for_byte() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("all.mcap");
    let mut writer = Writer::create(&path, &origin()).expect("a file");
    let mut sent = Vec::new();
    for (k, row) in SERVICES.iter().enumerate() {
        for copy in 0..3 {
            let service = row.instances[row.instances.len() - 1];
            let channel = writer
                .channel(&Channel::of(row, service))
                .expect("a channel");
            let at_ns = sent.len() as u64;
            let stamp = Stamp {
                recorded_ns: at_ns,
                taken_ns: 5 * at_ns,
                sequence: at_ns,
            };
            let body = noise(3 * k as u64 + copy + 1, row.message.bytes);
            let cdr = [&schema::ENCAPSULATION[..], &body].concat();
            writer.write_cdr(channel, stamp, &cdr).expect("written");
            sent.push((service, body));
        }
    }
    writer.finish().expect("finished");
    let recording = Recording::open(&path).expect("a recording");
    assert_eq!(recording.damage().count(), 0);
    let mut entries = recording.entries();
    for (k, (service, body)) in sent.iter().enumerate() {
        let entry = entries.next().expect("an entry").expect("whole");
        assert_eq!(entry.channel.service, *service);
        assert!(entry.bytes() == body, "{service} differs");
        assert_eq!(entry.recorded_ns(recording.origin()), k as u64);
        assert_eq!(entry.taken_ns, 5 * k as u64);
        let definition = &entry.channel.definition;
        assert!(
            definition.starts_with("vlaps_msgs/Header header\n"),
            "{definition}"
        );
    }
    assert!(entries.next().is_none());
}

#[test]
fn a_typed_message_is_the_one_that_was_written() {
    let folder = tempfile::tempdir().expect("a folder");
    ticks(&folder.path().join("a.mcap"), 0..25);
    ticks(&folder.path().join("b.mcap"), 25..50);
    let recording = Recording::open(folder.path()).expect("a recording");
    assert_eq!(recording.origin(), &origin());
    let steps: Vec<Step> = recording
        .messages(&STEP)
        .expect("of this layout")
        .map(|step| step.expect("whole"))
        .collect();
    assert_eq!(steps, (0..50).map(step).collect::<Vec<_>>());
    assert_eq!(recording.span_ns(), Some((0, 49 * PERIOD_NS + 1)));
    assert_eq!(recording.entries().count(), 100);
    assert_eq!(recording.entries_of(["observation"]).count(), 50);
}

#[test]
fn reading_begins_at_a_time_or_a_tick() {
    let folder = tempfile::tempdir().expect("a folder");
    ticks(&folder.path().join("a.mcap"), 0..25);
    ticks(&folder.path().join("b.mcap"), 25..50);
    let recording = Recording::open(folder.path()).expect("a recording");
    for tick in [0, 1, 9, 10, 24, 25, 26, 49] {
        let from = recording.entries().from_tick(tick).expect("readable");
        let rest: Vec<_> = from.map(|entry| entry.expect("whole")).collect();
        assert_eq!(rest.len() as u64, 2 * (50 - tick), "tick {tick}");
        assert!(rest[0].is(&OBSERVATION), "tick {tick}");
        assert_eq!(rest[0].header().map(|header| header.tick), Some(tick));
        let steps = recording.messages(&STEP).expect("of this layout");
        let first = steps.from_tick(tick).expect("readable").next();
        assert_eq!(first.expect("a step").expect("whole"), step(tick));
        // One nanosecond after the observation comes its step.
        let mut late = recording.entries().from_ns(tick * PERIOD_NS + 1);
        let first = late.next().expect("an entry").expect("whole");
        assert_eq!(first.read(&STEP), Some(step(tick)));
    }
    assert!(
        recording
            .entries()
            .from_tick(50)
            .expect("readable")
            .next()
            .is_none()
    );
    assert!(recording.entries().from_ns(u64::MAX).next().is_none());
}

#[test]
fn attachments_return() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let mut writer = Writer::create(&path, &origin()).expect("a file");
    let policy = noise(7, 100_000);
    writer
        .attach("config.toml", "application/toml", b"[run]\n")
        .expect("attached");
    writer.write(&STEP, 1, &step(0)).expect("written");
    let name = "policy/00000000000000ffabcd";
    writer
        .attach(name, "application/octet-stream", &policy)
        .expect("attached");
    writer.finish().expect("finished");
    let recording = Recording::open(&path).expect("a recording");
    assert_eq!(recording.attachments().count(), 2);
    let text = recording.configuration().expect("readable");
    assert_eq!(text.as_deref(), Some("[run]\n"));
    let found = recording.policy(0xff).expect("readable").expect("attached");
    assert!(found == policy);
    assert!(recording.policy(0xfe).expect("readable").is_none());
}

/// The log times of a file never decrease, even when the messages' own times do.
#[test]
fn an_earlier_message_is_logged_when_it_came() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let mut writer = Writer::create(&path, &origin()).expect("a file");
    for at_ns in [50, 40, 60] {
        writer.write(&STEP, at_ns, &step(at_ns)).expect("written");
    }
    writer.finish().expect("finished");
    let recording = Recording::open(&path).expect("a recording");
    let times: Vec<_> = recording
        .entries()
        .map(|entry| entry.expect("whole"))
        .map(|entry| {
            (
                entry.recorded_ns(recording.origin()),
                entry.taken_ns / PERIOD_NS,
            )
        })
        .collect();
    assert_eq!(times, [(50, 50), (50, 40), (60, 60)]);
}
