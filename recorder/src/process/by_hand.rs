//! A recorder that is started by hand, and the order to write a flight recording.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use runtime::SetUpError;
use shm_config::config::Keep;
use shm_config::run::{RunName, RunPaths};
use shm_config::services::Process;
use shm_config::time::monotonic;
use shm_config::wire::Wire;

use super::session::RecordingFolder;
use super::writing::Shared;
use super::{PATIENCE, Parts, Recorder, text};

/// How often the roster is looked for: a second in all.
const ROSTER_READS_MAX: u32 = 50;

/// What a recorder that was started by hand records.
#[derive(Debug, Clone)]
pub struct ByHand {
    /// The run.
    pub run: RunName,
    /// The folder of the recording.
    pub out: PathBuf,
    /// Seconds to record; 0 until it is stopped or the run ends.
    pub seconds: f64,
    /// Keep the last minute only, and write it when something happens.
    pub flight: bool,
}

/// Records a running set as one reader more; returns what was written in words.
///
/// # Errors
/// When no such set runs, or it cannot be read.
#[allow(clippy::disallowed_methods)] // a process entry point reads the clock
pub fn by_hand(what: &ByHand, stop: &AtomicBool) -> Result<String, SetUpError> {
    let own = |text: String| SetUpError::Own(text);
    let shared = Shared::open()?;
    let paths = RunPaths::new(what.run.clone());
    let Some(supervisor) = paths.supervisor_pid() else {
        let run = &what.run;
        return Err(own(format!(
            "run '{run}' is not running; `./vlaps status` shows what runs"
        )));
    };
    let config = shm_config::config::load(&paths.config_file())?;
    let place = RecordingFolder::at(&what.out, &config, supervisor)
        .map_err(|error| own(error.to_string()))?;
    if place.offset_ns.is_some() {
        let folder = what.out.display();
        return Err(own(format!(
            "{folder}: holds a recording of this run already; choose a new folder"
        )));
    }
    let wire = Wire::join(&what.run, Process::Recorder)?;
    wire.follow(supervisor)?;
    let parts = Parts {
        keep: if what.flight {
            Keep::Flight
        } else {
            Keep::Everything
        },
        judge: None,
        supervisor,
        place: RecordingFolder {
            from_start: false,
            ..place
        },
        shared,
    };
    let mut recorder = Recorder::start(&config, &wire, parts)?;
    let begun = monotonic();
    let limit_ns = match what.seconds > 0.0 {
        true => (what.seconds * 1e9) as u64,
        false => u64::MAX,
    };
    loop {
        let now = monotonic();
        let any = recorder.turn(now, &mut || !stop.load(Ordering::Relaxed));
        let is_over = now.since_ns(begun) >= limit_ns;
        // After the set's end the messages that it left are still read.
        let is_left = paths.supervisor_pid().is_none() && !any;
        if stop.load(Ordering::Relaxed) || is_over || is_left {
            break;
        }
        recorder.rest(any);
    }
    // What a flight recorder holds at its end is written.
    recorder.shared.flight.store(true, Ordering::Relaxed);
    let ended = recorder.finish(|| {});
    Ok(text(&ended))
}

/// Lets the flight recorder of a running set write its last minute now.
///
/// # Errors
/// When no such set runs, or it has no flight recorder.
pub fn write_now(run: &RunName) -> Result<String, SetUpError> {
    let own = |text: String| SetUpError::Own(text);
    let paths = RunPaths::new(run.clone());
    let Some(supervisor) = paths.supervisor_pid() else {
        return Err(own(format!(
            "run '{run}' is not running; `./vlaps status` shows what runs"
        )));
    };
    let config = shm_config::config::load(&paths.config_file())?;
    if config.keeps() != Keep::Flight {
        return Err(own(format!(
            "run '{run}' has no flight recorder; start it with `./vlaps up --set \
             record.keep=flight`"
        )));
    }
    let wire = Wire::join(run, Process::Supervisor)?;
    wire.follow(supervisor)?;
    let named = (0..ROSTER_READS_MAX).find_map(|_| {
        std::thread::park_timeout(PATIENCE);
        wire.named(Process::Recorder)
    });
    let pid = named.and_then(|pid| rustix::process::Pid::from_raw(i32::try_from(pid).ok()?));
    let asked = pid.map(|pid| rustix::process::kill_process(pid, rustix::process::Signal::USR1));
    match asked {
        Some(Ok(())) => Ok(format!("run '{run}' writes the last 60 s and the next 5 s")),
        _ => Err(own(format!("the recorder of run '{run}' does not answer"))),
    }
}
