//! What the page has to know before it draws: the run, the words of codes, the colours.

use serde::Serialize;
use shm_config::config::Config;
use shm_config::message::{Driver, Preference, Reason};
use shm_config::palette::{driver, hex};
use shm_config::services::Process;
use supervisor::show::clock::clock_word;

/// The description of what is shown.
#[derive(Debug, Clone, Serialize)]
pub struct Hello {
    /// `live` or `recording`.
    pub mode: &'static str,
    /// The run; `None` while none runs.
    pub run: Option<RunHello>,
    /// Why there is none, for the user; empty else.
    pub note: String,
    /// Name and colour of each driver, by code.
    pub drivers: Vec<(&'static str, String)>,
    /// The reasons by code.
    pub reasons: Vec<&'static str>,
    /// The preferences of a judge by code.
    pub preferences: Vec<&'static str>,
    /// The recording; `None` of a living run.
    pub recording: Option<RecordingHello>,
}

/// A run.
#[derive(Debug, Clone, Serialize)]
pub struct RunHello {
    /// Its name.
    pub name: String,
    /// Process id of its supervisor, by which the page tells runs of one name apart; 0 of
    /// a recording.
    pub supervisor: u32,
    /// Real time or lockstep.
    pub clock: &'static str,
    /// Ticks of the controller per second.
    pub rate_hz: f64,
    /// Rates of world, planner and controller, Hz.
    pub rates_hz: Vec<(&'static str, f64)>,
    /// The planner's method, a word.
    pub planner: String,
    /// The gate's mode, a word.
    pub gate: String,
    /// Whether a learner is part of the run.
    pub learns: bool,
    /// Length and width of the car, m.
    pub car_m: [f64; 2],
    /// Horizon of the rollouts, s.
    pub horizon_s: f64,
}

/// A recording.
#[derive(Debug, Clone, Serialize)]
pub struct RecordingHello {
    /// Its name.
    pub name: String,
    /// The first tick.
    pub first_tick: u64,
    /// The last tick.
    pub last_tick: u64,
}

impl Hello {
    /// Of a living run.
    pub fn live(config: &Config, supervisor: u32) -> Self {
        Self {
            run: Some(RunHello::new(config, supervisor)),
            ..Self::waiting(String::new())
        }
    }

    /// While no run lives, for this reason.
    pub fn waiting(note: String) -> Self {
        let drivers = Driver::ALL.iter();
        Self {
            mode: "live",
            run: None,
            note,
            drivers: drivers.map(|one| (one.word(), hex(driver(*one)))).collect(),
            reasons: Reason::ALL.iter().map(|reason| reason.word()).collect(),
            preferences: Preference::ALL.iter().map(|one| one.word()).collect(),
            recording: None,
        }
    }

    /// As the page reads it.
    pub fn json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl RunHello {
    /// From a run's configuration.
    pub fn new(config: &Config, supervisor: u32) -> Self {
        let footprint = config.vehicle.footprint();
        let rates = Process::ALL.iter().filter_map(|process| {
            let rate_hz = config.rate_hz(*process)?;
            Some((process.word(), rate_hz))
        });
        Self {
            name: config.run.name.clone(),
            supervisor,
            clock: clock_word(config),
            rate_hz: config.run.rate_hz,
            rates_hz: rates.collect(),
            planner: word(&config.planner.method),
            gate: word(&config.gate.mode),
            learns: config.learner.enabled,
            car_m: [footprint.length_m, footprint.width_m],
            horizon_s: config.safety.horizon_s,
        }
    }
}

/// A word of the configuration, as its file has it.
fn word(value: &impl Serialize) -> String {
    let json = serde_json::to_value(value).unwrap_or_default();
    json.as_str().unwrap_or_default().into()
}
