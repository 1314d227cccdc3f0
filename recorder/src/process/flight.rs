//! The flight recorder: the last minute in memory, written when something happens.

use std::collections::VecDeque;
use std::fs;
use std::io::Cursor;
use std::thread::JoinHandle;

use mcap::MessageStream;

use super::files::Enclosed;
use super::losses::{Losses, Lost};
use super::policies::Policies;
use super::ring::Label;
use super::storage::Storage;
use super::triggers::Triggers;
use super::writing::Written;
use crate::write::{ChannelId, Stamp};
use crate::{Channel, Origin, RecordingError, Writer};

/// How much is kept, ns on the run's clock.
pub(super) const KEPT_NS: u64 = 60_000_000_000;
/// How long it is recorded on after the event, ns on the run's clock.
const AFTER_NS: u64 = 5_000_000_000;
/// How long one piece is, ns on the run's clock.
const PIECE_NS: u64 = 1_000_000_000;
/// Bytes that the pieces may have; with more, less than a minute is kept. At 1,000 Hz a
/// minute has about 150 MB.
const KEPT_BYTES: u64 = 256 << 20;
/// The pieces have at most this part of the space of all recordings.
const KEPT_MIN: u64 = 2;

/// One second, as a whole file.
struct Piece {
    bytes: Vec<u8>,
    last_ns: u64,
    /// Its messages, by channel.
    counts: Vec<u64>,
}

/// The piece that is written.
struct Growing {
    writer: Writer<Cursor<Vec<u8>>>,
    ids: Vec<ChannelId>,
    first_ns: u64,
    counts: Vec<u64>,
}

/// An event that has happened, and when its recording is complete.
struct Due {
    reason: &'static str,
    until_ns: u64,
}

/// A flight recording that a thread writes. One at a time: with a disk that hangs, memory
/// holds the pieces of one and those that are kept.
struct Dumping {
    thread: JoinHandle<Result<Dumped, RecordingError>>,
    /// Its messages, by channel: lost when it fails.
    counts: Vec<u64>,
}

/// What was written.
struct Dumped {
    messages: u64,
    bytes: u64,
}

/// Keeps the last minute.
pub(super) struct Flight {
    storage: Storage,
    origin: Origin,
    channels: Vec<Channel>,
    enclosed: Enclosed,
    pieces: VecDeque<Piece>,
    growing: Option<Growing>,
    triggers: Triggers,
    due: Option<Due>,
    now_ns: u64,
    dumping: Option<Dumping>,
    written: Written,
}

impl Flight {
    pub(super) fn new(
        storage: Storage,
        origin: Origin,
        channels: Vec<Channel>,
        enclosed: Enclosed,
    ) -> Self {
        Self {
            storage,
            origin,
            channels,
            enclosed,
            pieces: VecDeque::new(),
            growing: None,
            triggers: Triggers::default(),
            due: None,
            now_ns: 0,
            dumping: None,
            written: Written::default(),
        }
    }

    /// Messages that the disk refused.
    pub(super) fn losses(&self) -> &Losses {
        &self.written.losses
    }

    /// The policy files in use now.
    pub(super) fn enclose(&mut self, used: Policies) {
        self.enclosed.policies = used;
    }

    /// Keeps a message, and looks for an event in it.
    pub(super) fn take(&mut self, label: Label, channel: &Channel, cdr: &[u8]) {
        self.now_ns = label.stamp.recorded_ns;
        if let Err(error) = self.keep(label, cdr) {
            tracing::warn!(%error, "a message is not kept");
        }
        if let Some(reason) = self.triggers.look(&channel.service, cdr) {
            self.trigger(reason);
        }
    }

    /// Writes the last minute soon.
    pub(super) fn trigger(&mut self, reason: &'static str) {
        if self.due.is_none() {
            let until_ns = self.now_ns.saturating_add(AFTER_NS);
            self.due = Some(Due { reason, until_ns });
        }
    }

    /// Writes what is due, once the recording before it is written.
    pub(super) fn advance(&mut self) {
        if self
            .dumping
            .as_ref()
            .is_some_and(|dumping| dumping.thread.is_finished())
        {
            self.join();
        }
        let is_due = |due: &Due| self.now_ns >= due.until_ns;
        if self.dumping.is_none() && self.due.as_ref().is_some_and(is_due) {
            self.write();
        }
    }

    fn keep(&mut self, label: Label, cdr: &[u8]) -> Result<(), RecordingError> {
        let recorded_ns = label.stamp.recorded_ns;
        let is_full = |growing: &Growing| recorded_ns.saturating_sub(growing.first_ns) >= PIECE_NS;
        if self.growing.as_ref().is_some_and(is_full) {
            self.complete()?;
        }
        if self.growing.is_none() {
            let mut writer = Writer::new(Cursor::new(Vec::new()), &self.origin)?;
            let ids = self.channels.iter().map(|channel| writer.channel(channel));
            let ids = ids.collect::<Result<_, _>>()?;
            self.growing = Some(Growing {
                writer,
                ids,
                first_ns: recorded_ns,
                counts: vec![0; self.channels.len()],
            });
        }
        if let Some(growing) = &mut self.growing {
            let id = growing.ids[label.channel];
            growing.writer.write_cdr(id, label.stamp, cdr)?;
            growing.counts[label.channel] += 1;
        }
        Ok(())
    }

    /// Completes the piece that grows, and forgets those that are too old.
    fn complete(&mut self) -> Result<(), RecordingError> {
        let Some(growing) = self.growing.take() else {
            return Ok(());
        };
        self.pieces.push_back(Piece {
            bytes: growing.writer.finish()?.into_inner(),
            last_ns: self.now_ns,
            counts: growing.counts,
        });
        let kept_max = KEPT_BYTES.min(self.storage.bytes_max / KEPT_MIN);
        let mut kept = bytes_of(&self.pieces);
        while let Some(oldest) = self.pieces.front() {
            let is_old = self.now_ns.saturating_sub(oldest.last_ns) > KEPT_NS;
            if !is_old && kept <= kept_max {
                break;
            }
            kept -= oldest.bytes.len() as u64;
            self.pieces.pop_front();
        }
        Ok(())
    }

    /// Writes all pieces, in a thread of its own: it takes seconds at 1,000 Hz. They are not
    /// written again by the next event.
    fn write(&mut self) {
        let Some(due) = self.due.take() else {
            return;
        };
        if let Err(error) = self.complete() {
            tracing::warn!(%error, "the last second is not kept");
        }
        let pieces = std::mem::take(&mut self.pieces);
        let mut counts = vec![0; self.channels.len()];
        for piece in &pieces {
            for (sum, count) in counts.iter_mut().zip(&piece.counts) {
                *sum += count;
            }
        }
        let dump = Dump {
            storage: self.storage.clone(),
            origin: self.origin.clone(),
            reason: due.reason,
            enclosed: self.enclosed.clone(),
            channels: self.channels.clone(),
            pieces,
        };
        let spawned = std::thread::Builder::new()
            .name("flight".into())
            .spawn(move || dump.write());
        match spawned {
            Ok(thread) => self.dumping = Some(Dumping { thread, counts }),
            Err(error) => self.lose(&counts, &error.to_string()),
        }
    }

    /// Waits for the recording that is written.
    fn join(&mut self) {
        let Some(Dumping { thread, counts }) = self.dumping.take() else {
            return;
        };
        match thread.join() {
            Ok(Ok(dumped)) => {
                self.written.files += 1;
                self.written.messages += dumped.messages;
                self.written.bytes += dumped.bytes;
            }
            Ok(Err(error)) => self.lose(&counts, &error.to_string()),
            Err(_) => self.lose(&counts, "its thread panicked"),
        }
    }

    /// A flight recording could not be written: its messages are counted as lost.
    fn lose(&mut self, counts: &[u64], why: &str) {
        tracing::warn!("the flight recording is lost: {why}");
        for (channel, count) in self.channels.iter().zip(counts) {
            self.written
                .losses
                .add(&channel.service, Lost::Disk, *count);
        }
    }

    /// Writes what is due, although the time after the event is not over.
    pub(super) fn finish(mut self) -> Written {
        self.join();
        self.write();
        self.join();
        Written {
            folder: self.storage.folder,
            ..self.written
        }
    }
}

fn bytes_of(pieces: &VecDeque<Piece>) -> u64 {
    pieces.iter().map(|piece| piece.bytes.len() as u64).sum()
}

/// One flight recording, to be written.
struct Dump {
    storage: Storage,
    origin: Origin,
    reason: &'static str,
    enclosed: Enclosed,
    channels: Vec<Channel>,
    pieces: VecDeque<Piece>,
}

impl Dump {
    /// Writes the pieces as one file, which is removed when that fails.
    fn write(mut self) -> Result<Dumped, RecordingError> {
        self.origin.facts.insert("event".into(), self.reason.into());
        let bytes = bytes_of(&self.pieces).saturating_add(self.enclosed.bytes());
        self.storage.free_space(&self.origin.run, bytes);
        let name = format!("{}-{}", self.origin.run, self.reason);
        let (path, writer) = self
            .enclosed
            .begin(&self.storage.folder, &name, &self.origin)?;
        let messages = self.fill(writer).inspect_err(|_| {
            let _ = fs::remove_file(&path);
        })?;
        let bytes = fs::metadata(&path).map_or(0, |metadata| metadata.len());
        let path = path.display();
        tracing::info!("{}: {messages} messages written to {path}", self.reason);
        Ok(Dumped { messages, bytes })
    }

    /// Writes the messages of the pieces; returns how many.
    fn fill(&self, mut writer: Writer) -> Result<u64, RecordingError> {
        let mut count = 0;
        for piece in &self.pieces {
            for message in MessageStream::new(&piece.bytes)? {
                let message = message?;
                let topic = &message.channel.topic;
                let channel = self
                    .channels
                    .iter()
                    .find(|channel| channel.topic() == *topic);
                let Some(channel) = channel else {
                    continue;
                };
                let id = writer.channel(channel)?;
                let stamp = Stamp {
                    recorded_ns: message.log_time.saturating_sub(self.origin.epoch_offset_ns),
                    taken_ns: message.publish_time,
                    sequence: u64::from(message.sequence),
                };
                writer.write_cdr(id, stamp, &message.data)?;
                count += 1;
            }
        }
        writer.finish()?;
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::sync::mpsc;

    use shm_config::layout::Layout;
    use shm_config::message::{Reason, Step};
    use shm_config::services::STEP;

    use super::*;
    use crate::Recording;
    use crate::schema::ENCAPSULATION;

    const SECOND_NS: u64 = 1_000_000_000;

    fn flight(folder: &Path) -> Flight {
        let storage = Storage {
            folder: folder.into(),
            root: folder.into(),
            bytes_max: 1 << 30,
        };
        let channels = vec![Channel::of(&STEP.row, STEP.name)];
        let enclosed = Enclosed {
            configuration: "[run]\n".into(),
            policies: vec![("5a".repeat(32), std::sync::Arc::from(&b"policy"[..]))],
        };
        Flight::new(storage, Origin::default(), channels, enclosed)
    }

    /// A step each second, of this number; that of the event is vetoed.
    fn drive(flight: &mut Flight, seconds: std::ops::RangeInclusive<u64>, event: u64) {
        for second in seconds {
            let mut step = Step::default();
            step.header.tick = second;
            if second == event {
                step.command.reason = Reason::Vetoed.code();
            }
            let cdr = [&ENCAPSULATION[..], step.as_bytes()].concat();
            let stamp = Stamp {
                recorded_ns: second * SECOND_NS,
                taken_ns: second * SECOND_NS,
                sequence: second,
            };
            let channel = flight.channels[0].clone();
            flight.take(Label { channel: 0, stamp }, &channel, &cdr);
            flight.advance();
        }
    }

    fn ticks(recording: &Recording) -> Vec<u64> {
        let steps = recording.messages(&STEP).expect("of this layout");
        steps.map(|step| step.expect("whole").header.tick).collect()
    }

    #[test]
    fn the_minute_before_an_event_and_the_seconds_after_it_are_written_once() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut flight = flight(folder.path());
        drive(&mut flight, 1..=200, 150);
        let written = flight.finish();
        let recording = Recording::open(folder.path()).expect("one recording");
        let ticks = ticks(&recording);
        let (kept, after) = (KEPT_NS / SECOND_NS, AFTER_NS / SECOND_NS);
        assert_eq!(ticks.last(), Some(&(150 + after)));
        assert!(ticks.is_sorted_by(|a, b| a + 1 == *b), "{ticks:?}");
        let count = ticks.len() as u64;
        // Pieces are forgotten whole.
        assert!((kept..=kept + 2).contains(&count), "{ticks:?}");
        assert_eq!((written.files, written.messages), (1, count));
        let path = recording.files().next().expect("a file");
        assert_eq!(written.bytes, fs::metadata(path).expect("there").len());
        assert!(path.display().to_string().contains("-veto-"));
        assert!(written.losses.is_empty());
        assert_eq!(recording.origin().fact("event"), "veto");
        let name = format!("policy/{}", "5a".repeat(32));
        let policy = recording.attachment(&name).expect("readable");
        assert_eq!(policy.as_deref(), Some(&b"policy"[..]));
        let text = recording.configuration().expect("readable");
        assert_eq!(text.as_deref(), Some("[run]\n"));
    }

    #[test]
    fn a_recording_that_the_disk_refuses_is_counted_and_leaves_no_file() {
        let above = tempfile::tempdir().expect("a folder");
        let mut flight = flight(&above.path().join("missing"));
        drive(&mut flight, 1..=20, 10);
        let written = flight.finish();
        // Those until 5 s after the event.
        assert_eq!(
            written.losses.to_string(),
            "step: queue 0, memory 0, disk 15"
        );
        assert_eq!((written.files, written.messages), (0, 0));
        assert_eq!(fs::read_dir(above.path()).expect("a folder").count(), 0);
    }

    #[test]
    fn an_event_waits_until_the_recording_before_it_is_written() {
        let folder = tempfile::tempdir().expect("a folder");
        let mut flight = flight(folder.path());
        let (go, wait) = mpsc::channel::<()>();
        let thread = std::thread::spawn(move || {
            let _ = wait.recv();
            let (messages, bytes) = (0, 0);
            Ok(Dumped { messages, bytes })
        });
        let counts = vec![0];
        flight.dumping = Some(Dumping { thread, counts });
        drive(&mut flight, 1..=30, 10);
        assert!(flight.due.is_some(), "the disk hangs");
        go.send(()).expect("it waits");
        let written = flight.finish();
        assert_eq!((written.files, written.messages), (2, 30));
        let recording = Recording::open(folder.path()).expect("a recording");
        assert_eq!(ticks(&recording), (1..=30).collect::<Vec<_>>());
    }
}
