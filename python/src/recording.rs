//! Recordings of runs: `vlaps.Recording` wraps these classes.
//!
//! Messages cross the border as bytes; the package makes NumPy types of the definitions that
//! the recording holds.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::PathBuf;
use std::sync::Mutex;

use numpy::PyArray1;
use pyo3::exceptions::{PyFileNotFoundError, PyIndexError, PyOSError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use recorder::{Channel, Entries, Entry};
use shm_config::Message;
use shm_config::layout::Layout;
use shm_config::message::{
    Driver, FEATURES, Judge, Lateness, Observation, Outcome, Preference, Reason, Stage, Verdict,
};

use crate::calls::take;

pyo3::create_exception!(
    vlaps,
    RecordingError,
    PyValueError,
    "A recording that cannot be read; the message says where, why, and what to do."
);

fn refused(error: recorder::RecordingError) -> PyErr {
    let text = error.to_string();
    match error {
        recorder::RecordingError::Io { source, .. } if source.kind() == ErrorKind::NotFound => {
            PyFileNotFoundError::new_err(text)
        }
        recorder::RecordingError::Io { .. } => PyOSError::new_err(text),
        _ => RecordingError::new_err(text),
    }
}

/// Service, schema, definition, whether this build has the same layout, count, and when the
/// first and the last message were recorded, ns on the run's clock.
type ChannelRow = (String, String, String, bool, u64, u64, u64);

/// A recording that is open.
#[pyclass(frozen, module = "vlaps")]
pub struct RecordingFile {
    recording: recorder::Recording,
}

impl RecordingFile {
    fn entries_of(&self, services: Option<Vec<String>>, from_ns: u64) -> Entries {
        let entries = match &services {
            Some(names) => self.recording.entries_of(names.iter().map(String::as_str)),
            None => self.recording.entries(),
        };
        entries.from_ns(from_ns)
    }
}

#[pymethods]
impl RecordingFile {
    /// Opens a folder with the files of one run, or one file.
    #[new]
    fn new(py: Python, path: PathBuf) -> PyResult<Self> {
        let recording = py.detach(|| recorder::Recording::open(&path));
        Ok(Self {
            recording: recording.map_err(refused)?,
        })
    }

    /// Each service that the recording has a message of.
    fn channels(&self, py: Python) -> Vec<ChannelRow> {
        let counts = py.detach(|| self.recording.counts());
        let offset_ns = self.recording.origin().epoch_offset_ns;
        let channels = self.recording.channels().into_iter();
        channels
            .filter_map(|channel| {
                let count = counts.get(&channel.service)?;
                let ours = Channel::named(&channel.service);
                Some((
                    channel.service.clone(),
                    channel.schema.clone(),
                    channel.definition.clone(),
                    ours.is_some_and(|ours| ours.layout == channel.layout),
                    count.messages,
                    count.first_log_ns.saturating_sub(offset_ns),
                    count.last_log_ns.saturating_sub(offset_ns),
                ))
            })
            .collect()
    }

    /// When the first and the last message were recorded, ns on the run's clock.
    fn span_ns(&self) -> Option<(u64, u64)> {
        self.recording.span_ns()
    }

    /// What the recording says about its run.
    fn metadata(&self) -> BTreeMap<String, String> {
        let origin = self.recording.origin();
        let mut facts = origin.facts.clone();
        facts.insert("run".into(), origin.run.clone());
        facts.insert("session".into(), origin.session.clone());
        facts.insert("lockstep".into(), u8::from(origin.is_lockstep).to_string());
        facts.insert("epoch_offset_ns".into(), origin.epoch_offset_ns.to_string());
        facts
    }

    /// The files in order of time.
    fn files(&self) -> Vec<PathBuf> {
        self.recording.files().map(PathBuf::from).collect()
    }

    /// One line for each file that ends before its end.
    fn damage(&self) -> Vec<String> {
        self.recording.damage().map(String::from).collect()
    }

    /// Name, media type and bytes of each attachment.
    fn attachments(&self) -> Vec<(String, String, u64)> {
        let all = self.recording.attachments();
        all.map(|one| (one.name.clone(), one.media_type.clone(), one.bytes))
            .collect()
    }

    /// The data of an attachment by its place in `attachments`.
    fn attachment<'py>(&self, py: Python<'py>, place: usize) -> PyResult<Bound<'py, PyBytes>> {
        let found = self.recording.attachments().nth(place);
        let found = found.ok_or_else(|| PyIndexError::new_err("no such attachment"))?;
        let data = py.detach(|| self.recording.data(found)).map_err(refused)?;
        Ok(PyBytes::new(py, &data))
    }

    /// The messages of a service recorded from one time to another, ns on the run's clock,
    /// one after the other; and when each was recorded. `shape` is the bytes of a message, and
    /// that each so many-th is read.
    #[allow(clippy::type_complexity)] // two arrays, for Python
    fn read<'py>(
        &self,
        py: Python<'py>,
        service: String,
        span_ns: (u64, u64),
        shape: (usize, usize),
    ) -> PyResult<(Bound<'py, PyArray1<u8>>, Bound<'py, PyArray1<u64>>)> {
        let ((from_ns, to_ns), (bytes, every)) = (span_ns, shape);
        let origin = self.recording.origin();
        let (data, times) = py.detach(|| -> PyResult<_> {
            let (mut data, mut times) = (Vec::new(), Vec::new());
            let entries = self.entries_of(Some(vec![service]), from_ns);
            for (number, entry) in entries.enumerate() {
                let entry = entry.map_err(refused)?;
                let recorded_ns = entry.recorded_ns(origin);
                if recorded_ns > to_ns {
                    break;
                }
                if !number.is_multiple_of(every.max(1)) {
                    continue;
                }
                data.extend_from_slice(checked(&entry, bytes)?);
                times.push(recorded_ns);
            }
            Ok((data, times))
        })?;
        Ok((PyArray1::from_vec(py, data), PyArray1::from_vec(py, times)))
    }

    /// The messages of these services, or of all, from one time to another, a few at a time.
    fn messages(&self, services: Option<Vec<String>>, span_ns: (u64, u64)) -> RecordedMessages {
        let (from_ns, to_ns) = span_ns;
        let entries = self.entries_of(services, from_ns);
        RecordedMessages {
            entries: Mutex::new(Some(entries)),
            offset_ns: self.recording.origin().epoch_offset_ns,
            to_ns,
        }
    }
}

/// The message's memory, which must have this length.
fn checked(entry: &Entry, bytes: usize) -> PyResult<&[u8]> {
    let memory = entry.bytes();
    match memory.len() == bytes {
        true => Ok(memory),
        false => Err(RecordingError::new_err(format!(
            "a message of '{}' has {} bytes in place of the {bytes} of its definition; the \
             recording is damaged, or of another program",
            entry.channel.service,
            memory.len()
        ))),
    }
}

/// Service, time of recording and of taking, ns on the run's clock, and the message's bytes.
type MessageRow<'py> = (String, u64, u64, Bound<'py, PyBytes>);

/// Messages in order of time; at most one chunk of them is in memory.
#[pyclass(frozen, module = "vlaps")]
pub struct RecordedMessages {
    /// `None` after the last message.
    entries: Mutex<Option<Entries>>,
    offset_ns: u64,
    to_ns: u64,
}

#[pymethods]
impl RecordedMessages {
    /// The next messages, at most this many; none after the last one.
    fn next<'py>(&self, py: Python<'py>, most: usize) -> PyResult<Vec<MessageRow<'py>>> {
        let mut guard = take(&self.entries)?;
        let entries: &mut Option<Entries> = &mut guard;
        let found = py.detach(|| -> PyResult<Vec<Entry>> {
            let mut found = Vec::new();
            while let Some(open) = entries.as_mut().filter(|_| found.len() < most) {
                match open.next() {
                    Some(entry) => {
                        let entry = entry.map_err(refused)?;
                        match entry.log_ns.saturating_sub(self.offset_ns) > self.to_ns {
                            true => *entries = None,
                            false => found.push(entry),
                        }
                    }
                    None => *entries = None,
                }
            }
            Ok(found)
        })?;
        let row = |entry: Entry| {
            let service = entry.channel.service.clone();
            let recorded_ns = entry.log_ns.saturating_sub(self.offset_ns);
            let bytes = PyBytes::new(py, entry.bytes());
            (service, recorded_ns, entry.taken_ns, bytes)
        };
        Ok(found.into_iter().map(row).collect())
    }
}

/// The policy's input for observations of this build's layout, one after the other,
/// `[count * 259]`.
#[pyfunction]
pub fn observation_features<'py>(
    py: Python<'py>,
    observations: &[u8],
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let count = observations.len() / size_of::<Observation>();
    let mut features = Vec::with_capacity(count * FEATURES);
    let mut row = [0.0; FEATURES];
    for (number, bytes) in observations
        .chunks_exact(size_of::<Observation>())
        .enumerate()
    {
        let observation = Observation::from_bytes(bytes);
        let observation = observation.filter(|observation| observation.check().is_ok());
        let made = observation.as_ref().and_then(|it| it.features(&mut row));
        match made.filter(|made| made.len() == FEATURES) {
            Some(made) => features.extend_from_slice(made),
            None => {
                return Err(PyValueError::new_err(format!(
                    "observation {number} is no input of a policy: it needs {FEATURES} numbers, \
                     those of a lidar with 240 beams"
                )));
            }
        }
    }
    Ok(PyArray1::from_vec(py, features))
}

/// The words of the codes in messages, by the name of their list.
#[pyfunction]
pub fn words() -> BTreeMap<&'static str, BTreeMap<u32, &'static str>> {
    macro_rules! lists {
        ($($list:ident),+) => {
            [$((
                stringify!($list),
                $list::ALL.iter().map(|one| (one.code(), one.word())).collect(),
            )),+]
        };
    }
    lists!(
        Driver, Judge, Lateness, Outcome, Preference, Reason, Stage, Verdict
    )
    .into()
}
