//! ONNX Runtime as back end, for nets that are no chain of layers.
//!
//! Its call allocates: the Rust wrapper five times a run as it is called here
//! (`./vlaps bench policy` counts them), and the library behind it builds a frame
//! of execution on the C heap each time, which no binding prevents. So it never runs in
//! the tick's thread. A thread of its own holds the session; the tick gives it the
//! features and sleeps until the answer or `policy.ort_wait_us`. Without an answer there
//! is no proposal: the expert drives, and an old action is never repeated.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle, Thread};
use std::time::Duration;

use ort::environment::Environment;
use ort::session::Session;
use ort::session::builder::GraphOptimizationLevel;
use ort::value::TensorRef;
use policy::{ACTIONS, Names, Refusal, short_hash};
use shm_config::Instant;
use shm_config::message::INPUTS_WITH_MOTION;
use vehicle::Action;

use super::Policy;

/// Names the library, or its folder, where the configuration does not.
const VARIABLE: &str = "ORT_DYLIB_PATH";
/// The library's file.
const FILE: &str = "libonnxruntime.so";
/// Beside the build: what `./vlaps setup onnxruntime` fills.
const HOME: &str = "onnxruntime";

/// A session without its thread.
pub struct OrtSession {
    session: Session,
    names: Names,
}

/// The library: by configuration, by environment, or as set up.
///
/// # Errors
/// When it is nowhere, with what to do.
pub fn library(configured: &str) -> Result<PathBuf, Refusal> {
    let named = match configured.is_empty() {
        false => Some(PathBuf::from(configured)),
        true => std::env::var_os(VARIABLE).map(PathBuf::from),
    };
    let missing = |place: &Path| {
        Refusal::NoBackEnd(format!(
            "the net needs ONNX Runtime, and {} has none: run ./vlaps setup onnxruntime",
            place.display()
        ))
    };
    if let Some(place) = named {
        return find(&place).ok_or_else(|| missing(&place));
    }
    let own = std::env::current_exe().unwrap_or_default();
    // target/PROFILE/vlaps-controller, or target/PROFILE/deps/TEST.
    let homes = own.ancestors().skip(2).take(2).map(|dir| dir.join(HOME));
    let mut first = None;
    for home in homes {
        match find(&home) {
            Some(file) => return Ok(file),
            None => first = first.or(Some(home)),
        }
    }
    Err(missing(&first.unwrap_or_default()))
}

/// The library itself, in a folder, or in a package folder below it; with or
/// without a version behind its name.
fn find(place: &Path) -> Option<PathBuf> {
    if place.is_file() {
        return Some(place.into());
    }
    [place.to_path_buf(), place.join("onnxruntime/capi")]
        .iter()
        .filter_map(|folder| std::fs::read_dir(folder).ok())
        .flat_map(|entries| entries.flatten())
        .map(|entry| entry.path())
        .find(|path| {
            path.file_name()
                .is_some_and(|name| name.to_string_lossy().starts_with(FILE))
        })
}

fn failed(what: &str, error: &dyn std::fmt::Display) -> Refusal {
    let text = error.to_string();
    let line = text.lines().next().unwrap_or_default();
    Refusal::NoBackEnd(format!("ONNX Runtime {what}: {line}"))
}

/// The library's environment: loaded and made once in a process, whichever
/// library is named later.
fn environment(library: &Path) -> Result<Environment, Refusal> {
    static ENVIRONMENT: Mutex<Option<Environment>> = Mutex::new(None);
    let mut made = ENVIRONMENT
        .lock()
        .unwrap_or_else(|broken| broken.into_inner());
    if let Some(environment) = &*made {
        return Ok(environment.clone());
    }
    let what = format!("in {} cannot be loaded", library.display());
    let builder = ort::init_from(library).map_err(|error| failed(&what, &error))?;
    let environment = builder.build().map_err(|error| failed(&what, &error))?;
    Ok(made.insert(environment).clone())
}

impl OrtSession {
    /// A session of one thread for a file that passed all other checks.
    ///
    /// # Errors
    /// When the library cannot be loaded or refuses the graph.
    pub fn new(library: &Path, bytes: &[u8], names: &Names) -> Result<Self, Refusal> {
        let environment = environment(library)?;
        let refused = |error: ort::Error| failed("refuses the file", &error);
        let builder = Session::builder(&environment).map_err(refused)?;
        let option = |error: &dyn std::fmt::Display| failed("refuses an option", error);
        let session = builder
            .with_optimization_level(GraphOptimizationLevel::Level3)
            .map_err(|error| option(&error))?
            .with_intra_threads(1)
            .map_err(|error| option(&error))?
            .with_inter_threads(1)
            .map_err(|error| option(&error))?
            .commit_from_memory(bytes)
            .map_err(refused)?;
        Ok(Self {
            session,
            names: names.clone(),
        })
    }

    /// How many numbers it takes.
    fn inputs(&self) -> usize {
        self.names.input_shape.iter().product::<i64>() as usize
    }

    /// The answer; NaN when the library has none.
    pub fn infer(&mut self, features: &[f32]) -> [f32; ACTIONS] {
        self.run(features).unwrap_or([f32::NAN; ACTIONS])
    }

    fn run(&mut self, features: &[f32]) -> Option<[f32; ACTIONS]> {
        let features = features.get(..self.inputs())?;
        let shape = self.names.input_shape.clone();
        let input = TensorRef::from_array_view((shape, features)).ok()?;
        let inputs = ort::inputs![self.names.input.as_str() => input];
        let outputs = self.session.run(inputs).ok()?;
        let output = outputs.get(self.names.output.as_str())?;
        let (_, values) = output.try_extract_tensor::<f32>().ok()?;
        values.try_into().ok()
    }
}

/// What tick and helper share. Numbers grow; a lock is held for a copy only,
/// and the tick only ever tries it.
struct Shared {
    asked: AtomicU64,
    features: Mutex<[f32; INPUTS_WITH_MOTION]>,
    answer: Mutex<(u64, [f32; ACTIONS])>,
    tick_thread: Mutex<Option<Thread>>,
}

/// Number asked that ends the helper.
const END: u64 = u64::MAX;

/// A session in a thread of its own.
pub struct OrtPolicy {
    shared: Arc<Shared>,
    helper: Option<JoinHandle<()>>,
    asked: u64,
    wait_ns: u64,
    clock: fn() -> Instant,
    knows_me: bool,
    takes_motion: bool,
    version: u64,
    hash: u64,
}

impl OrtPolicy {
    /// Starts the helper. To be called where no real-time priority is in force.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn new(
        session: OrtSession,
        (version, sha256): (u64, &[u8; 32]),
        wait: Duration,
        clock: fn() -> Instant,
    ) -> Result<Self, Refusal> {
        let takes_motion = session.inputs() == INPUTS_WITH_MOTION;
        let shared = Arc::new(Shared {
            asked: AtomicU64::new(0),
            features: Mutex::new([0.0; INPUTS_WITH_MOTION]),
            answer: Mutex::new((0, [0.0; ACTIONS])),
            tick_thread: Mutex::new(None),
        });
        let ours = shared.clone();
        let helper = thread::Builder::new()
            .name("onnxruntime".into())
            .spawn(move || answer(session, &ours))
            .map_err(|error| Refusal::NoBackEnd(format!("cannot start a thread: {error}")))?;
        Ok(Self {
            shared,
            helper: Some(helper),
            asked: 0,
            wait_ns: wait.as_nanos() as u64,
            clock,
            knows_me: false,
            takes_motion,
            version,
            hash: short_hash(sha256),
        })
    }
}

/// The helper's loop.
fn answer(mut session: OrtSession, shared: &Shared) {
    let (mut done, mut features) = (0, [0.0; INPUTS_WITH_MOTION]);
    loop {
        let asked = shared.asked.load(Ordering::Acquire);
        if asked == END {
            return;
        }
        if asked == done {
            thread::park();
            continue;
        }
        if let Ok(given) = shared.features.lock() {
            features = *given;
        }
        let action = session.infer(&features);
        done = asked;
        if let Ok(mut answer) = shared.answer.lock() {
            *answer = (asked, action);
        }
        if let Ok(thread) = shared.tick_thread.lock()
            && let Some(thread) = &*thread
        {
            thread.unpark();
        }
    }
}

impl Policy for OrtPolicy {
    fn infer(&mut self, features: &[f32]) -> Option<Action> {
        let until = (self.clock)().after_ns(self.wait_ns);
        if !self.knows_me {
            *self.shared.tick_thread.try_lock().ok()? = Some(thread::current());
            self.knows_me = true;
        }
        // The helper still reads the features of an earlier tick: no answer for this one.
        let mut room = self.shared.features.try_lock().ok()?;
        let count = features.len().min(INPUTS_WITH_MOTION);
        room[..count].copy_from_slice(&features[..count]);
        drop(room);
        self.asked += 1;
        self.shared.asked.store(self.asked, Ordering::Release);
        self.helper.as_ref()?.thread().unpark();
        loop {
            if let Ok(answer) = self.shared.answer.try_lock()
                && answer.0 == self.asked
            {
                let [steer, pedal] = answer.1.map(f64::from);
                return Some(Action { steer, pedal });
            }
            let now = (self.clock)();
            if now >= until {
                return None;
            }
            thread::park_timeout(Duration::from_nanos(until.since_ns(now)));
        }
    }

    fn takes_motion(&self) -> bool {
        self.takes_motion
    }

    fn version(&self) -> u64 {
        self.version
    }

    fn hash(&self) -> u64 {
        self.hash
    }
}

impl Drop for OrtPolicy {
    fn drop(&mut self) {
        self.shared.asked.store(END, Ordering::Release);
        if let Some(helper) = self.helper.take() {
            helper.thread().unpark();
            let _ = helper.join();
        }
    }
}
