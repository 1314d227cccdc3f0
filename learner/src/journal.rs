//! The replay on disk. Each transition is appended when it arrives, so a killed learner
//! loses only the last few.
//!
//! Records follow one another, each with a checksum; an incomplete record at the end is
//! cut off when the file is opened. When the file holds much more than the replay
//! buffers, it is replaced by a shorter one, as a whole or not at all.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use shm_config::file::{Access, Durable, open_ours, replace_with};
use shm_config::message::Preference;

use crate::assembler::Counts;
use crate::replay::{ACTIONS, Buffer, INPUTS, Replay, Then, Transition};

/// The first bytes of the file: name and version of the format.
const MAGIC: &[u8; 8] = b"VLREPL03";
/// Floating-point numbers in a transition.
const NUMBERS: usize = 2 * INPUTS + 3 * ACTIONS;
/// Counters beside each transition.
const COUNTERS: usize = 12;
/// Codes beside them: buffer, label, successor.
const CODES: usize = 3;
/// Bytes of a record: numbers, codes, counters, checksum.
pub const RECORD: usize = 4 * NUMBERS + CODES + 8 * COUNTERS + 4;
/// The file is replaced when it holds this many times the capacity of the buffers.
const SLACK: u64 = 2;

/// Records of a new file that are written to the disk at once: 6.5 MB.
const SYNCED: u64 = 2048;

/// Maximum value of a counter, far beyond every run: sums of counters stay within 64 bits.
const COUNTER_MAX: u64 = 1 << 62;

/// Records at the end of a file that are searched for a valid one.
const LOOK_BACK: u64 = 64;

/// The counts at the time when a record was written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Mark {
    /// Counts of steps and transitions.
    pub counts: Counts,
    /// Process id of the controller.
    pub producer: u32,
    /// Its last step's sequence number.
    pub sequence: u64,
    /// Updates made.
    pub updates: u64,
}

impl Mark {
    /// The mark, advanced to these counts. Only a step that completes a transition
    /// writes a mark, so the last block may have ended some steps later. Each of these
    /// steps had a sequence number; if it were not skipped here, it would count a
    /// second time, as lost.
    #[must_use]
    pub fn reached(self, counts: &Counts) -> Mark {
        let counts = self.counts.max(counts);
        let further = counts.driven() - self.counts.driven();
        let sequence = match self.sequence {
            // The controller is unknown.
            0 => 0,
            sequence => sequence.saturating_add(further),
        };
        Mark {
            counts,
            sequence,
            ..self
        }
    }
}

/// The journal's file, opened for appending.
pub struct Journal {
    path: PathBuf,
    file: BufWriter<File>,
    records: u64,
}

/// The content of a journal's file.
pub struct Recovered {
    /// The file, opened for appending.
    pub journal: Journal,
    /// The transitions, in their replay buffers.
    pub replay: Replay,
    /// The last record's mark.
    pub mark: Option<Mark>,
    /// Bytes of an incomplete record that were cut off.
    pub torn_bytes: u64,
}

impl Journal {
    /// Opens or creates the file and reads its transitions. `learnt` is the number of
    /// transitions at the end of the last block.
    ///
    /// # Errors
    /// When the file cannot be read or written, has another format, or holds fewer
    /// transitions than were learnt from. It is then left unchanged.
    pub fn open(path: &Path, capacity: usize, learnt: u64) -> io::Result<Recovered> {
        let mut file = open_ours(path, Access::Change)?;
        let length = file.metadata()?.len();
        let mut replay = Replay::new(capacity);
        let Content {
            mark,
            records,
            has_magic,
        } = Content::read(&file, &mut replay)?;
        check_whole(mark, learnt)?;
        if !has_magic {
            // A learner was killed while it created the file.
            file.set_len(0)?;
            file.rewind()?;
            file.write_all(MAGIC)?;
        }
        let whole = MAGIC.len() as u64 + records * RECORD as u64;
        let torn_bytes = length.saturating_sub(whole);
        file.set_len(whole)?;
        file.seek(SeekFrom::End(0))?;
        let journal = Journal {
            path: path.into(),
            file: BufWriter::new(file),
            records,
        };
        Ok(Recovered {
            journal,
            replay,
            mark,
            torn_bytes,
        })
    }

    /// Appends a transition.
    ///
    /// # Errors
    /// When the file cannot be written, for example on a full disk.
    pub fn append(
        &mut self,
        buffer: Buffer,
        transition: &Transition,
        mark: &Mark,
    ) -> io::Result<()> {
        self.records += 1;
        self.file.write_all(&encode(buffer, transition, mark))
    }

    /// Passes all buffered records to the kernel: a kill then loses none of them.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }

    /// Passes all buffered records to the disk: a power cut then loses none of them.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn sync(&mut self) -> io::Result<()> {
        self.file.flush()?;
        self.file.get_ref().sync_data()
    }

    /// Replaces the file by a shorter one when it holds much more than the replay.
    /// `heartbeat` is called meanwhile: the default replay has up to 330 MB, whose writing
    /// may take longer than a process may be silent.
    ///
    /// # Errors
    /// When the new file cannot be written; the old one then stays.
    pub fn compact(
        &mut self,
        replay: &Replay,
        mark: &Mark,
        heartbeat: &mut dyn FnMut(),
    ) -> io::Result<()> {
        let held = Buffer::ALL.len() * replay.capacity();
        if self.records <= SLACK * held as u64 {
            return Ok(());
        }
        let mut records = 0;
        replace_with(&self.path, Durable::Yes, |file| {
            let mut file = BufWriter::new(file);
            file.write_all(MAGIC)?;
            for buffer in Buffer::ALL {
                for transition in replay.iter(buffer) {
                    file.write_all(&encode(buffer, transition, mark))?;
                    records += 1;
                    if records % SYNCED == 0 {
                        // Otherwise the last sync would wait for the whole file.
                        file.flush()?;
                        file.get_ref().sync_data()?;
                        heartbeat();
                    }
                }
            }
            file.flush()
        })?;
        self.file = BufWriter::new(open_ours(&self.path, Access::Append)?);
        self.records = records;
        Ok(())
    }
}

/// A kill damages only the last record, and each transition was in the file before it
/// was learnt from. If transitions are missing, another program has cut the file.
/// Continuing would count the missing steps a second time and never reach the last
/// step.
fn check_whole(mark: Option<Mark>, learnt: u64) -> io::Result<()> {
    let held = mark.map_or(0, |mark| mark.counts.transitions());
    if held >= learnt {
        return Ok(());
    }
    let what = format!(
        "is damaged: it holds {held} of the {learnt} transitions that were learnt from; put the \
         whole file back, or move its folder away to start anew"
    );
    Err(io::Error::new(io::ErrorKind::InvalidData, what))
}

/// Checks the first bytes of a file, which may be fewer after a kill.
fn check_magic(magic: &[u8]) -> io::Result<()> {
    if MAGIC.starts_with(magic) {
        return Ok(());
    }
    let (name, own) = MAGIC.split_at(MAGIC.len() - 2);
    let own = String::from_utf8_lossy(own);
    let what = match magic.strip_prefix(name) {
        Some(version) => format!(
            "is no replay of this version: it has version {}, this build reads version {own}; \
             continue with the build that began it, or move it away to begin a new one",
            String::from_utf8_lossy(version).escape_default()
        ),
        None => "is no replay of this version; move it away to begin a new one".into(),
    };
    Err(io::Error::new(io::ErrorKind::InvalidData, what))
}

/// What a file holds up to its first invalid record.
struct Content {
    mark: Option<Mark>,
    records: u64,
    has_magic: bool,
}

impl Content {
    /// Adds what the file holds to the replay.
    fn read(file: &File, replay: &mut Replay) -> io::Result<Content> {
        let mut content = Content {
            mark: None,
            records: 0,
            has_magic: false,
        };
        let mut reader = BufReader::with_capacity(1 << 20, file);
        let mut magic = Vec::with_capacity(MAGIC.len());
        let mut first = reader.by_ref().take(MAGIC.len() as u64);
        first.read_to_end(&mut magic)?;
        check_magic(&magic)?;
        content.has_magic = magic.len() == MAGIC.len();
        if content.has_magic {
            let mut record = [0; RECORD];
            while let Whole::Yes = read_record(&mut reader, &mut record)? {
                let Some((buffer, transition, mark)) = decode(&record) else {
                    break;
                };
                replay.push(buffer, transition);
                content.mark = Some(mark);
                content.records += 1;
            }
        }
        Ok(content)
    }
}

/// Adds the transitions of a file to a replay; returns the file's last mark. `learnt` is as in
/// [`Journal::open`]. The file is only read, and a learner may be using it.
///
/// # Errors
/// When the file cannot be read, has another format, or holds fewer transitions than were learnt
/// from.
pub fn read(path: &Path, replay: &mut Replay, learnt: u64) -> io::Result<Option<Mark>> {
    let mark = Content::read(&File::open(path)?, replay)?.mark;
    check_whole(mark, learnt)?;
    Ok(mark)
}

/// The counts of a file's last valid record; `None` if the file is missing or holds
/// none. The file is only read, and another process may be using it.
///
/// # Errors
/// When the file cannot be read or has another format.
pub fn last_mark(path: &Path) -> io::Result<Option<Mark>> {
    let mut file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
    };
    let mut magic = Vec::with_capacity(MAGIC.len());
    let mut first = Read::by_ref(&mut file).take(MAGIC.len() as u64);
    first.read_to_end(&mut magic)?;
    check_magic(&magic)?;
    let body = file.metadata()?.len().saturating_sub(MAGIC.len() as u64);
    let mut record = [0; RECORD];
    // A kill leaves at most one or two incomplete records at the end.
    for back in 1..=(body / RECORD as u64).min(LOOK_BACK) {
        let index = body / RECORD as u64 - back;
        file.seek(SeekFrom::Start(MAGIC.len() as u64 + index * RECORD as u64))?;
        if let Whole::Yes = read_record(&mut file, &mut record)?
            && let Some((_, _, mark)) = decode(&record)
        {
            return Ok(Some(mark));
        }
    }
    Ok(None)
}

/// Whether a record was read completely.
enum Whole {
    Yes,
    No,
}

/// A read error is not the end of the file: nothing is cut off then.
fn read_record(reader: &mut impl Read, record: &mut [u8; RECORD]) -> io::Result<Whole> {
    match reader.read_exact(record) {
        Ok(()) => Ok(Whole::Yes),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(Whole::No),
        Err(error) => Err(error),
    }
}

fn counters(mark: &Mark) -> [u64; COUNTERS] {
    let counts = &mark.counts;
    [
        counts.steps,
        counts.lost,
        counts.unseen,
        counts.cut,
        counts.expert,
        counts.policy,
        counts.unlabelled,
        counts.interventions,
        counts.imagined,
        u64::from(mark.producer),
        mark.sequence,
        mark.updates,
    ]
}

fn encode(buffer: Buffer, transition: &Transition, mark: &Mark) -> [u8; RECORD] {
    let mut record = [0; RECORD];
    let (body, sum) = record.split_at_mut(RECORD - 4);
    let (numbers, rest) = body.split_at_mut(4 * NUMBERS);
    let values = [&transition.state[..], &transition.next]
        .into_iter()
        .chain([
            &transition.applied[..],
            &transition.policy,
            &transition.expert,
        ])
        .flatten();
    for (bytes, value) in numbers.chunks_exact_mut(4).zip(values) {
        bytes.copy_from_slice(&value.to_le_bytes());
    }
    rest[0] = buffer as u8;
    rest[1] = match transition.label {
        Preference::Abstain => 0,
        Preference::Expert => 1,
        Preference::Policy => 2,
    };
    rest[2] = match transition.then {
        Then::Unknown => 0,
        Then::On => 1,
        Then::End => 2,
    };
    for (bytes, count) in rest[CODES..].chunks_exact_mut(8).zip(counters(mark)) {
        bytes.copy_from_slice(&count.to_le_bytes());
    }
    let crc = crc32fast::hash(body);
    sum.copy_from_slice(&crc.to_le_bytes());
    record
}

/// `None` when the checksum, a code or a counter is wrong.
fn decode(record: &[u8; RECORD]) -> Option<(Buffer, Transition, Mark)> {
    let (body, sum) = record.split_at(RECORD - 4);
    if crc32fast::hash(body).to_le_bytes() != sum {
        return None;
    }
    let (numbers, rest) = body.split_at(4 * NUMBERS);
    let mut numbers = numbers
        .chunks_exact(4)
        .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
    let mut state = [0.0; INPUTS];
    let mut next = [0.0; INPUTS];
    let mut actions = [[0.0; ACTIONS]; 3];
    let places = state
        .iter_mut()
        .chain(&mut next)
        .chain(actions.iter_mut().flatten());
    for place in places {
        *place = numbers.next()?;
    }
    let [applied, policy, expert] = actions;
    let buffer = Buffer::ALL
        .into_iter()
        .find(|&buffer| buffer as u8 == rest[0])?;
    let label = match rest[1] {
        0 => Preference::Abstain,
        1 => Preference::Expert,
        2 => Preference::Policy,
        _ => return None,
    };
    let then = match rest[2] {
        0 => Then::Unknown,
        1 => Then::On,
        2 => Then::End,
        _ => return None,
    };
    let mut words = rest[CODES..].chunks_exact(8).map(|bytes| {
        let mut word = [0; 8];
        word.copy_from_slice(bytes);
        u64::from_le_bytes(word)
    });
    let mut word = || words.next().filter(|word| *word <= COUNTER_MAX);
    let counts = Counts {
        steps: word()?,
        lost: word()?,
        unseen: word()?,
        cut: word()?,
        expert: word()?,
        policy: word()?,
        unlabelled: word()?,
        interventions: word()?,
        imagined: word()?,
    };
    let mark = Mark {
        counts,
        producer: word()? as u32,
        sequence: word()?,
        updates: word()?,
    };
    let transition = Transition {
        state,
        next,
        applied,
        policy,
        expert,
        label,
        then,
    };
    Some((buffer, transition, mark))
}
