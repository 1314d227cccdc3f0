//! The thread that writes: from the ring to the disk.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use shm_config::services::{POLICY_STATUS, WEIGHTS};
use shm_config::time::Clock;
use shm_config::{Instant, counted};

use super::files::Files;
use super::flight::Flight;
use super::losses::Losses;
use super::policies::Offers;
use super::ring::{Label, RingOut};
use super::shown::Shown;
use crate::Channel;
use crate::schema::ENCAPSULATION;

/// Where messages go.
pub(super) enum Sink {
    /// To files, all of them.
    Files(Files),
    /// To memory, and to a file when something happens.
    Flight(Flight),
}

/// What the threads tell each other.
#[derive(Debug, Default)]
pub(super) struct Shared {
    /// The disk's thread is to write what is in the ring, and end.
    pub(super) end: AtomicBool,
    /// Write the flight recording now.
    pub(super) flight: Arc<AtomicBool>,
    /// Messages that the disk refused so far.
    pub(super) refused: AtomicU64,
    /// When the disk's thread last went on, ns on the machine's clock; 0 before it began.
    pub(super) alive_ns: AtomicU64,
    /// Messages lost before the disk, for the files.
    pub(super) before_disk: Mutex<Losses>,
}

impl Shared {
    /// Messages lost before the disk.
    fn losses(&self) -> Losses {
        let losses = self.before_disk.lock();
        losses.map_or_else(|_| Losses::default(), |losses| losses.clone())
    }
}

impl Shared {
    /// From now on SIGUSR1 asks for the flight recording.
    ///
    /// # Errors
    /// When the system refuses.
    pub(super) fn open() -> io::Result<Arc<Self>> {
        let shared = Arc::new(Self::default());
        signal_hook::flag::register(signal_hook::consts::SIGUSR1, shared.flight.clone())?;
        Ok(shared)
    }
}

/// What was written, at the end.
#[derive(Debug, Default)]
pub(super) struct Written {
    pub(super) messages: u64,
    pub(super) files: u64,
    pub(super) bytes: u64,
    pub(super) losses: Losses,
    pub(super) folder: PathBuf,
}

/// The writing thread.
pub(super) struct Writing {
    pub(super) ring: RingOut,
    pub(super) sink: Sink,
    pub(super) channels: Vec<Channel>,
    /// Makes the standard topics, if they are wanted.
    pub(super) shown: Option<Shown>,
    pub(super) clock: Clock,
    /// The judge's folder, whose files are attached at the end.
    pub(super) judge: Option<PathBuf>,
    pub(super) offers: Offers,
}

impl Writing {
    /// Writes until it is told to end.
    pub(super) fn run(mut self, shared: &Shared) -> Written {
        let mut cdr = Vec::with_capacity(64 << 10);
        loop {
            // Read before the ring: what was put in before the end is written.
            let is_ending = shared.end.load(Ordering::Acquire);
            let is_abandoned = self.ring.is_abandoned();
            let mut now = (self.clock)();
            shared.alive_ns.store(now.0, Ordering::Relaxed);
            let mut count = 0_u32;
            while let Some(label) = self.ring.pop(&mut cdr) {
                self.take(label, &cdr, now);
                count += 1;
                if count.is_multiple_of(256) {
                    now = (self.clock)();
                    shared.alive_ns.store(now.0, Ordering::Relaxed);
                    self.advance(shared, now);
                }
            }
            self.advance(shared, now);
            if is_ending || is_abandoned {
                break;
            }
            // Woken by the drain, and often enough to complete a chunk.
            std::thread::park_timeout(super::PATIENCE);
        }
        self.finish(shared)
    }

    fn take(&mut self, label: Label, cdr: &[u8], now: Instant) {
        let service = self.channels[label.channel].service.as_str();
        let memory = cdr.get(ENCAPSULATION.len()..).unwrap_or_default();
        let offer = match service == WEIGHTS.name {
            true => self.offers.note_offer(memory),
            false => None,
        };
        if service == POLICY_STATUS.name
            && let Some(used) = self.offers.note_status(memory)
        {
            match &mut self.sink {
                Sink::Files(files) => files.enclose(used),
                Sink::Flight(flight) => flight.enclose(used),
            }
        }
        let (channels, sink) = (&self.channels, &mut self.sink);
        let service = channels[label.channel].service.as_str();
        let mut put = |label: Label, cdr: &[u8]| match sink {
            Sink::Files(files) => files.take(label, cdr, now),
            Sink::Flight(flight) => flight.take(label, &channels[label.channel], cdr),
        };
        put(label, cdr);
        if let Some(shown) = &mut self.shown {
            shown.take((service, label), memory, &mut put);
        }
        if let (Some(sha256), Sink::Files(files)) = (offer, &mut self.sink) {
            files.note_offer(sha256);
        }
    }

    fn advance(&mut self, shared: &Shared, now: Instant) {
        match &mut self.sink {
            Sink::Files(files) => {
                files.advance(now, || shared.losses());
                let refused = files.losses().total();
                shared.refused.store(refused, Ordering::Relaxed);
            }
            Sink::Flight(flight) => {
                if shared.flight.swap(false, Ordering::Relaxed) {
                    flight.trigger("command");
                }
                flight.advance();
                let refused = flight.losses().total();
                shared.refused.store(refused, Ordering::Relaxed);
            }
        }
    }

    fn finish(self, shared: &Shared) -> Written {
        let now = (self.clock)();
        match self.sink {
            Sink::Files(mut files) => {
                if let Some(judge) = &self.judge {
                    attach_judge(&mut files, judge, now);
                }
                files.finish(now, shared.losses());
                Written {
                    messages: files.count,
                    files: files.files,
                    bytes: files.bytes,
                    losses: files.losses().clone(),
                    folder: files.folder().to_path_buf(),
                }
            }
            Sink::Flight(flight) => flight.finish(),
        }
    }
}

/// Attaches the judge's questions and pictures, as many as the space for attachments holds.
fn attach_judge(files: &mut Files, folder: &Path, now: Instant) {
    let mut left = files.attachments_max();
    let (mut omitted, mut omitted_bytes) = (0_u64, 0);
    for path in judge_files(folder) {
        let length = fs::metadata(&path).map_or(0, |metadata| metadata.len());
        if length > left {
            omitted += 1;
            omitted_bytes += length;
            continue;
        }
        let (Ok(name), Ok(data)) = (path.strip_prefix(folder), fs::read(&path)) else {
            continue;
        };
        left -= length;
        let media_type = match path.extension().and_then(|ending| ending.to_str()) {
            Some("png") => "image/png",
            Some("jpg" | "jpeg") => "image/jpeg",
            Some("jsonl") => "application/jsonl",
            _ => "application/octet-stream",
        };
        files.attach(
            (&format!("judge/{}", name.display()), media_type),
            &data,
            now,
        );
    }
    if omitted > 0 {
        let folder = folder.display();
        tracing::warn!(
            "{folder}: {} of {omitted_bytes} bytes not in the recording, which has {} bytes for \
             them; raise record.max_mb",
            counted(omitted, "file"),
            files.attachments_max()
        );
    }
}

/// The judge's files: texts first, because they are small and name the pictures.
fn judge_files(folder: &Path) -> Vec<PathBuf> {
    let (mut paths, mut folders) = (Vec::new(), vec![folder.to_path_buf()]);
    while let Some(inner) = folders.pop() {
        for entry in fs::read_dir(inner).into_iter().flatten().flatten() {
            match entry.file_type() {
                Ok(kind) if kind.is_dir() => folders.push(entry.path()),
                Ok(kind) if kind.is_file() => paths.push(entry.path()),
                _ => {}
            }
        }
    }
    let is_text = |path: &Path| path.extension().is_some_and(|ending| ending == "jsonl");
    paths.sort_unstable_by_key(|path| (!is_text(path), path.clone()));
    paths
}

#[cfg(test)]
mod tests {
    use shm_config::services::STEP;

    use super::*;
    use crate::process::files::Enclosed;
    use crate::process::ring;
    use crate::process::storage::Storage;
    use crate::{Origin, Recording};

    #[test]
    fn the_judge_s_files_are_attached_without_an_open_file_as_far_as_they_fit() {
        let place = tempfile::tempdir().expect("a folder");
        let folders = ["rec", "judge", "judge/pictures"].map(|name| place.path().join(name));
        for folder in &folders {
            fs::create_dir(folder).expect("a folder");
        }
        let [folder, judge, pictures] = folders;
        fs::write(judge.join("questions.jsonl"), b"{}\n").expect("written");
        fs::write(pictures.join("1.png"), vec![7; 20_000]).expect("written");
        fs::write(pictures.join("2.png"), vec![7; 2_000]).expect("written");
        let storage = Storage {
            folder: folder.clone(),
            root: folder.clone(),
            bytes_max: 80_000,
        };
        let channels = vec![Channel::of(&STEP.row, STEP.name)];
        let origin = Origin::default();
        let mut files = Files::new(storage, origin, channels.clone(), Enclosed::default());
        files.reserve_for_attachments();
        let (_into, out) = ring::ring(100);
        let writing = Writing {
            ring: out,
            sink: Sink::Files(files),
            shown: None,
            channels,
            clock: || Instant(1),
            judge: Some(judge),
            offers: Offers::new(Vec::new()),
        };
        assert_eq!(writing.finish(&Shared::default()).files, 1);
        let recording = Recording::open(&folder).expect("a recording");
        let named = recording.attachments();
        let named: Vec<_> = named.map(|file| (file.name.as_str(), file.bytes)).collect();
        let expected = [
            ("config.toml", 0),
            ("judge/questions.jsonl", 3),
            ("judge/pictures/2.png", 2_000),
        ];
        assert_eq!(named, expected);
    }
}
