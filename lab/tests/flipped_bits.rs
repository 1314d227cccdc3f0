//! A flipped bit anywhere in a recording is found and named, or it is in no input.

use std::fs;
use std::path::Path;

use lab::replay::messages::AnyMessage;
use lab::replay::recorded::Recorded;
use lab::replay::rehearsal::Rehearsal;
use lab::replay::run::{PROCESSES, Replayed, Task, replay};
use lab::replay::source::{InMemory, Source};
use shm_config::Instant;
use shm_config::difference::first_difference;
use shm_config::draw::Draw;
use shm_config::layout::Layout;
use shm_config::message::{Header, Message};

const TICKS: usize = 200;
const SEED: u64 = 1;
/// Ticks at both ends of the run whose neighbours are not recorded.
const ENDS: u64 = 20;

fn clock() -> Instant {
    Instant(0)
}

fn replayed(source: &mut dyn Source) -> anyhow::Result<Replayed> {
    let task = Task {
        processes: PROCESSES.to_vec(),
        from: 0,
        tick: None,
    };
    replay(source, &task, clock, |_| {})
}

fn rehearsed() -> InMemory {
    let run = Rehearsal::troubled(SEED).and_then(|run| run.run(TICKS));
    run.expect("a rehearsal")
}

/// Flips one bit of a message; the topic, its header before, and the field.
fn flip<M: Message + Layout>(
    topic: &'static str,
    message: &mut M,
    draw: &mut Draw,
) -> (&'static str, Header, String) {
    let before = *message;
    let mut bytes = message.as_bytes().to_vec();
    let at = draw.below(8 * bytes.len() as u64) as usize;
    bytes[at / 8] ^= 1 << (at % 8);
    *message = M::from_bytes(&bytes).expect("as many bytes");
    let field = first_difference(&before, message).expect("a bit is another");
    (topic, *before.header(), field.field)
}

fn flip_any(message: &mut AnyMessage, draw: &mut Draw) -> (&'static str, Header, String) {
    match message {
        AnyMessage::Observation(message) => flip("observation", message, draw),
        AnyMessage::Plan(message) => flip("plan", message, draw),
        AnyMessage::Command(message) => flip("command", message, draw),
        AnyMessage::Advice(message) => flip("advice", message, draw),
        AnyMessage::Takeover(message) => flip("takeover", message, draw),
        AnyMessage::Step(message) => flip("step", message, draw),
        AnyMessage::Progress(message) => flip("progress", message, draw),
        AnyMessage::Episode(message) => flip("episode", message, draw),
        AnyMessage::Learning(message) => flip("learning", message, draw),
    }
}

/// Fields from which nothing is computed: notes about the run.
fn is_no_input(topic: &str, field: &str) -> bool {
    let notes: &[&str] = match topic {
        "step" => &[
            // How long the tick took, when its inputs were published, how often it was woken.
            "timings.", "skipped",
        ],
        "plan" => &["planning_ns"],
        // The supervisor alone reads it, for the screen. It is compared where its header names
        // an observation of an episode that goes on.
        "progress" => &["command_age_max_ns", "skipped", "outcome", "header."],
        "episode" => &["command_age_max_ns", "skipped", "header."],
        _ => &[],
    };
    notes.iter().any(|note| field.starts_with(note))
}

#[test]
fn a_flipped_bit_in_any_message_is_found_or_in_no_input() {
    let mut clean = rehearsed();
    let equal = replayed(&mut clean).expect("a replay");
    assert_eq!(equal.first_difference, None);
    let mut draw = Draw::new(79);
    let (mut found, mut missed) = (0, Vec::new());
    let last = clean
        .messages
        .iter()
        .filter_map(tick_of)
        .max()
        .expect("ticks");
    for case in 0..150 {
        let mut run = clean.clone();
        run.at = 0;
        let at = draw.below(run.messages.len() as u64) as usize;
        let tick = tick_of(&run.messages[at]).unwrap_or_default();
        if tick < ENDS || tick + ENDS > last {
            continue;
        }
        let (topic, header, field) = flip_any(&mut run.messages[at], &mut draw);
        let what = format!(
            "case {case}: message {at}, {topic}.{field}, tick {}",
            header.tick
        );
        let again = replayed(&mut run).expect("a replay");
        match again.first_difference {
            Some(first) => {
                assert!(
                    !first.field.is_empty() && first.recorded != first.recomputed,
                    "{what}: {first:?}"
                );
                assert!(
                    first.tick.abs_diff(header.tick) <= 100 || field.starts_with("header."),
                    "{what}: {first:?}"
                );
                found += 1;
            }
            // The replay says that it does not have the weights of this step.
            None if !again.missing_policies.is_empty() => {
                assert!(field.ends_with("weights_hash"), "{what}");
                found += 1;
            }
            None if is_no_input(topic, &field) => {}
            None => missed.push(what),
        }
    }
    assert!(
        missed.is_empty(),
        "{} missed, {found} found:\n{}",
        missed.len(),
        missed.join("\n")
    );
    assert!(found > 80, "{found}");
}

fn tick_of(message: &AnyMessage) -> Option<u64> {
    match message {
        AnyMessage::Observation(message) => Some(message.header.tick),
        AnyMessage::Step(message) => Some(message.header.tick),
        AnyMessage::Command(message) => Some(message.header.tick),
        AnyMessage::Plan(message) => Some(message.header.tick),
        AnyMessage::Advice(message) => Some(message.header.tick),
        AnyMessage::Takeover(message) => Some(message.header.tick),
        AnyMessage::Progress(message) => Some(message.header.tick),
        AnyMessage::Episode(message) => Some(message.header.tick),
        AnyMessage::Learning(message) => Some(message.header.tick),
    }
}

/// What is wrong with a file; `None` when it is replayed and each byte is equal.
fn wrong(path: &Path) -> Option<String> {
    let mut recorded = match Recorded::open(path) {
        Ok(recorded) => recorded,
        Err(error) => return Some(format!("{error:#}")),
    };
    if let Err(error) = recorded.verify() {
        return Some(format!("{error:#}"));
    }
    match replayed(&mut recorded) {
        Ok(replayed) => replayed.first_difference.map(|first| format!("{first:?}")),
        Err(error) => Some(format!("{error:#}")),
    }
}

/// Chunks, their heads, metadata, attachments, indices, checksums, magic.
#[test]
fn a_flipped_bit_anywhere_in_a_file_is_found_and_the_file_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let (path, flipped) = (folder.path().join("a.mcap"), folder.path().join("b.mcap"));
    rehearsed().save(&path).expect("a recording");
    assert_eq!(wrong(&path), None);
    let whole = fs::read(&path).expect("readable");
    let mut draw = Draw::new(80);
    let anywhere = (0..400).map(|_| draw.below(8 * whole.len() as u64));
    // Every bit of both ends, which have few bytes of a file.
    let bits = 8 * whole.len() as u64;
    let ends = (0..400).chain(bits - 600..bits).step_by(7);
    for bit in anywhere.chain(ends).collect::<Vec<_>>() {
        let mut bytes = whole.clone();
        bytes[bit as usize / 8] ^= 1 << (bit % 8);
        fs::write(&flipped, &bytes).expect("written");
        let said = wrong(&flipped).unwrap_or_else(|| panic!("bit {bit} of {bits}: not found"));
        assert!(
            said.contains("b.mcap") && !said.contains('\n'),
            "bit {bit}: {said}"
        );
    }
}
