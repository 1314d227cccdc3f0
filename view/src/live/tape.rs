//! A recording as the page reads it: its course, found once in the background, and the
//! scenes and processes of any tick, on request.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use gate::record::store::{PICTURES, QUESTIONS};
use recorder::{Entry, Recording, RecordingError};
use shm_config::Message as _;
use shm_config::config::{self, Config};
use shm_config::message::Step;
use shm_config::services::{EPISODE, POLICY_STATUS, PROGRESS, Process, STEP, health, timing};
use shm_config::text::printable;
use supervisor::cli::failure::Failure;
use supervisor::telemetry::tally::Tally;

use super::events::{Detector, Event};
use super::hello::{Hello, RecordingHello, RunHello};
use super::history::History;
use super::scene::Painter;
use super::status::{RunFolder, Status, question_at};
use super::tree::{SearchTree, search};

/// Samples of a whole recording: at 20 Hz those of ten minutes, 2.5 MB of JSON; of a longer
/// one a sample covers more time.
const SAMPLES_MAX: u64 = 12_000;
/// Least time of a sample, ns: the page's 20 Hz.
const SAMPLE_NS: u64 = 50_000_000;
/// Events that are kept, the first of the recording.
const EVENTS_MAX: usize = 5_000;
/// The attachments of the judge's record begin with this.
const JUDGE: &str = "judge/";
/// Scenes of one answer.
const FRAMES_MAX: usize = 64;
/// With more ticks between two scenes, each is looked up, and the steps between them are
/// not read.
const READ_THROUGH_MAX: u64 = 64;
/// The bodies are followed this long before the first scene of an answer, ns.
const FOLLOW_NS: u64 = 1_200_000_000;
/// Time from scan to scan while they are, ns.
const FOLLOW_STEP_NS: u64 = 100_000_000;
/// How far back the processes' last messages are looked for, ns: histograms come twice
/// a second.
const STATUS_BACK_NS: u64 = 3_000_000_000;

/// A recording.
#[derive(Debug)]
pub struct Tape {
    recording: Recording,
    config: Config,
    hello: Hello,
    course: Mutex<Course>,
}

/// The course of a recording, as far as it is read.
#[derive(Debug, Default)]
struct Course {
    /// Samples as JSON.
    samples: Vec<String>,
    events: Vec<Event>,
    restarts: Vec<(u64, Process)>,
    /// The share that is read, [0, 1].
    indexed: f64,
    last_tick: u64,
    /// Why reading ended early; empty else.
    error: String,
}

impl Tape {
    /// Opens a recording: a folder with the files of one run, or one file.
    ///
    /// # Errors
    /// When there is none, it is foreign or of a later format, or it has no step.
    pub fn open(path: &Path) -> Result<Self, Failure> {
        let failed = |error: RecordingError| Failure::Usage(error.to_string());
        let recording = Recording::open(path).map_err(failed)?;
        let text = recording.configuration().map_err(failed)?;
        let origin = path.display().to_string();
        let config = match &text {
            Some(text) => config::from_toml(text, &origin)?,
            None => Config::default(),
        };
        let first = recording.messages(&STEP).map_err(failed)?.next();
        let first = first
            .ok_or_else(|| Failure::Usage(format!("{origin}: holds no step of a controller")))?
            .map_err(failed)?;
        let last_tick = last_tick(&recording).map_err(failed)?;
        let name = path
            .file_name()
            .map(|name| name.to_string_lossy().into_owned());
        let recorded = RecordingHello {
            name: printable(&name.unwrap_or_default()).into_owned(),
            first_tick: first.header.tick,
            last_tick,
        };
        let note = recording.damage().next().map(printable).unwrap_or_default();
        let mut run = RunHello::new(&config, 0);
        run.name = printable(&recording.origin().run).into_owned();
        let hello = Hello {
            mode: "recording",
            run: Some(run),
            recording: Some(recorded),
            ..Hello::waiting(note.into_owned())
        };
        let course = Course {
            last_tick,
            ..Course::default()
        };
        Ok(Self {
            recording,
            config,
            hello,
            course: Mutex::new(course),
        })
    }

    /// The description of the recording, JSON.
    pub fn hello(&self) -> String {
        self.hello.json()
    }

    fn course(&self) -> MutexGuard<'_, Course> {
        // The course is whole between two statements that change it.
        self.course.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts reading the course in a thread of its own.
    ///
    /// # Errors
    /// When no thread can be had.
    pub fn begin(self: &Arc<Self>) -> std::io::Result<()> {
        let tape = self.clone();
        let reading = move || {
            let outcome = tape.read_course();
            let mut course = tape.course();
            if let Err(error) = outcome {
                course.error = printable(&error.to_string()).into_owned();
            }
            course.indexed = 1.0;
        };
        let thread = std::thread::Builder::new().name("view-course".into());
        thread.spawn(reading).map(drop)
    }

    /// Reads every step once.
    fn read_course(&self) -> Result<(), RecordingError> {
        let (from_ns, to_ns) = self.recording.span_ns().unwrap_or((0, 1));
        let span_ns = to_ns.saturating_sub(from_ns).max(1);
        let sample_ns = (span_ns / SAMPLES_MAX).max(SAMPLE_NS);
        let (mut history, mut detector) = (History::default(), Detector::default());
        let mut due_ns = from_ns.saturating_add(sample_ns);
        let families = Process::ALL.iter().map(|process| health(*process).name);
        let single = [STEP.name, PROGRESS.name, EPISODE.name, POLICY_STATUS.name];
        let mut failure = None;
        for entry in self
            .recording
            .entries_of(single.into_iter().chain(families))
        {
            let entry = match entry {
                Ok(entry) => entry,
                // The chunks behind a damaged one are read on.
                Err(error) => {
                    failure.get_or_insert(error);
                    continue;
                }
            };
            let recorded_ns = entry.recorded_ns(self.recording.origin());
            if recorded_ns >= due_ns {
                due_ns = recorded_ns.saturating_add(sample_ns);
                let share = (recorded_ns - from_ns) as f64 / span_ns as f64;
                self.add(&mut history, &mut detector, share.min(0.999));
            }
            detect(&entry, &mut history, &mut detector);
        }
        self.add(&mut history, &mut detector, 1.0);
        failure.map_or(Ok(()), Err)
    }

    fn add(&self, history: &mut History, detector: &mut Detector, share: f64) {
        let mut course = self.course();
        if let Some(sample) = history.take() {
            course.last_tick = course.last_tick.max(sample.tick);
            let sample = serde_json::to_string(&sample).unwrap_or_default();
            course.samples.push(sample);
        }
        let room = EVENTS_MAX - course.events.len();
        course.events.extend(detector.take().into_iter().take(room));
        course.restarts.append(&mut detector.restarts);
        course.indexed = share;
    }

    /// The course as far as it is read, JSON.
    pub fn overview(&self) -> String {
        let course = self.course();
        let events = serde_json::to_string(&course.events).unwrap_or_default();
        let error = serde_json::to_string(&course.error).unwrap_or_default();
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "{{\"indexed\":{:.3},\"last_tick\":{},\"error\":{error},\"events\":{events},\
             \"samples\":[{}]}}",
            course.indexed,
            course.last_tick,
            course.samples.join(",")
        );
        text
    }

    /// The scenes of this many steps from a tick on, with at least `stride` ticks between
    /// two of them, JSON.
    ///
    /// # Errors
    /// When the recording is damaged there.
    pub fn frames(&self, from: u64, count: usize, stride: u64) -> Result<String, RecordingError> {
        let (count, stride) = (count.clamp(1, FRAMES_MAX), stride.max(1));
        let mut painter = Painter::new(&self.config);
        self.follow_until(from, &mut painter)?;
        let mut scenes = Vec::new();
        let mut wanted = from;
        let mut steps = self.recording.messages(&STEP)?.from_tick(from)?;
        while scenes.len() < count {
            let Some(step) = steps.next() else { break };
            let step = step?;
            if step.header.tick < wanted || !is_drawn(&step) {
                continue;
            }
            let scene = painter.scene(&step);
            scenes.push(serde_json::to_string(&scene).unwrap_or_default());
            wanted = step.header.tick.saturating_add(stride);
            if stride > READ_THROUGH_MAX {
                steps = self.recording.messages(&STEP)?.from_tick(wanted)?;
            }
        }
        Ok(format!("[{}]", scenes.join(",")))
    }

    /// Follows the bodies in the scans before a tick, so that its scene has their tracks.
    fn follow_until(&self, tick: u64, painter: &mut Painter) -> Result<(), RecordingError> {
        let period_ns = self.config.run.period_ns().max(1);
        let begin = tick.saturating_sub(FOLLOW_NS / period_ns);
        let apart = FOLLOW_STEP_NS.div_ceil(period_ns);
        let mut wanted = begin;
        for step in self.recording.messages(&STEP)?.from_tick(begin)? {
            let step = step?;
            if step.header.tick >= tick {
                break;
            }
            if step.header.tick >= wanted && is_drawn(&step) {
                painter.follow(&step);
                wanted = step.header.tick.saturating_add(apart);
            }
        }
        Ok(())
    }

    fn step(&self, tick: u64) -> Result<Option<Step>, RecordingError> {
        let steps = self.recording.messages(&STEP)?.from_tick(tick)?;
        let mut good = steps.filter(|step| step.as_ref().map_or(true, is_drawn));
        good.next().transpose()
    }

    /// How the processes do at a tick, JSON; `None` when no step has it.
    ///
    /// # Errors
    /// When the recording is damaged there.
    pub fn status(&self, tick: u64) -> Result<Option<String>, RecordingError> {
        let Some(step) = self.step(tick)? else {
            return Ok(None);
        };
        let until_ns = step.header.taken_ns;
        let mut tally = Tally::default();
        let families = Process::ALL.iter();
        let families = families.flat_map(|of| [health(*of).name, timing(*of).name]);
        let single = [PROGRESS.name, EPISODE.name, POLICY_STATUS.name];
        let entries = self
            .recording
            .entries_of(single.into_iter().chain(families));
        for entry in entries.from_ns(until_ns.saturating_sub(STATUS_BACK_NS)) {
            let entry = entry?;
            if entry.recorded_ns(self.recording.origin()) > until_ns {
                break;
            }
            count(&entry, &mut tally);
        }
        tally.count_step(&step);
        let mut restarts = BTreeMap::<String, u32>::new();
        let course = self.course();
        for (_, process) in course.restarts.iter().filter(|(at, _)| *at <= tick) {
            *restarts.entry(process.word().into()).or_default() += 1;
        }
        drop(course);
        let nowhere = &mut RunFolder::default();
        let mut status = Status::new(&self.config, &tally, (&restarts, None), nowhere);
        let lines = self.recording.attachment(&format!("{JUDGE}{QUESTIONS}"))?;
        status.question = question_at(&lines.unwrap_or_default(), tick);
        Ok(serde_json::to_string(&status).ok())
    }

    /// The judge's picture of this name; `None` when the recording has none.
    ///
    /// # Errors
    /// When the recording is damaged there.
    pub fn picture(&self, name: &str) -> Result<Option<Vec<u8>>, RecordingError> {
        self.recording
            .attachment(&format!("{JUDGE}{PICTURES}/{name}"))
    }

    /// The search tree of a tick; `None` when no step has it.
    ///
    /// # Errors
    /// When the recording is damaged there, or the planner refuses.
    pub fn tree(&self, tick: u64) -> anyhow::Result<Option<SearchTree>> {
        let step = self.step(tick)?;
        step.map(|step| search(&self.config, &step)).transpose()
    }
}

/// Whether a step can be drawn: its content is admissible, and it has an observation.
fn is_drawn(step: &Step) -> bool {
    step.observation_age_ns != u64::MAX && step.check().is_ok()
}

/// The tick of the last step, in the last second of the recording.
fn last_tick(recording: &Recording) -> Result<u64, RecordingError> {
    let (_, to_ns) = recording.span_ns().unwrap_or_default();
    let steps = recording.messages(&STEP)?;
    let last = steps.from_ns(to_ns.saturating_sub(1_000_000_000));
    Ok(last
        .flatten()
        .map(|step| step.header.tick)
        .max()
        .unwrap_or(0))
}

fn detect(entry: &Entry, history: &mut History, detector: &mut Detector) {
    if let Some(step) = entry.read(&STEP) {
        if step.check().is_ok() {
            detector.step(&step);
            history.add(&step);
        }
    } else if let Some(progress) = entry.read(&PROGRESS) {
        if progress.check().is_ok() {
            detector.progress(&progress);
        }
    } else if let Some(episode) = entry.read(&EPISODE) {
        if episode.check().is_ok() {
            detector.episode(&episode);
        }
    } else if let Some(status) = entry.read(&POLICY_STATUS) {
        if status.check().is_ok() {
            detector.policy(&status);
        }
    } else {
        for process in Process::ALL {
            if let Some(message) = entry.read(&health(*process))
                && message.check().is_ok()
            {
                detector.health(*process, &message);
            }
        }
    }
}

fn count(entry: &Entry, tally: &mut Tally) {
    if let Some(progress) = entry.read(&PROGRESS) {
        tally.count_progress(progress);
    } else if let Some(episode) = entry.read(&EPISODE) {
        tally.count_episode(episode);
    } else if let Some(status) = entry.read(&POLICY_STATUS) {
        tally.count_policy(status);
    }
    for process in Process::ALL {
        if let Some(message) = entry.read(&health(*process)) {
            // An inadmissible one is counted nowhere.
            let _ = tally.count_health(*process, &message);
        } else if let Some(message) = entry.read(&timing(*process))
            && message.check().is_ok()
        {
            tally.count_timing(*process, message);
        }
    }
}
