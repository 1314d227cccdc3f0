//! How drive and processes are doing, for `diagnostic_msgs/DiagnosticArray`.

use shm_config::message::{Driver, Grant, Health, HealthState, Lateness, Step};
use shm_config::services::Process;

use super::messages::{Diagnosis, Level};

/// The word of an age; `none` for the value that stands for no message.
fn age_ms(ns: u64) -> String {
    match ns {
        u64::MAX => "none".into(),
        ns => format!("{:.1}", ns as f64 / 1e6),
    }
}

/// Who drives and why.
pub(super) fn drive(step: &Step) -> Diagnosis {
    let driver = step.driver();
    let reason = step.reason().map_or("unknown", |reason| reason.word());
    let lateness = Lateness::from_code(step.lateness);
    let level = match (driver, lateness) {
        (Driver::Brake, _) => Level::Error,
        (_, Some(Lateness::OnTime)) => Level::Ok,
        _ => Level::Warn,
    };
    let assessment = match driver {
        Driver::Policy => &step.policy_assessment,
        Driver::Expert | Driver::Brake => &step.expert_assessment,
    };
    let timings = &step.timings;
    let response_ns = timings.commanded_ns.saturating_sub(timings.scheduled_ns);
    let advice = match step.advice.header.sequence {
        0 => "none",
        _ => step.advice.preference().word(),
    };
    let values = vec![
        ("tick", step.header.tick.to_string()),
        ("episode", step.header.episode.to_string()),
        (
            "speed_mps",
            format!("{:.2}", step.observation.ego.speed_mps),
        ),
        ("steer", format!("{:.3}", step.command.steer)),
        ("pedal", format!("{:.3}", step.command.pedal)),
        ("verdict", assessment.verdict().word().into()),
        ("advice", advice.into()),
        ("stage", step.stage().word().into()),
        ("observation_age_ms", age_ms(step.observation_age_ns)),
        ("plan_age_ms", age_ms(step.plan_age_ns)),
        ("advice_age_ms", age_ms(step.advice_age_ns)),
        ("response_ms", age_ms(response_ns)),
        (
            "lateness",
            lateness.map_or("unknown", Lateness::word).into(),
        ),
        ("weights_version", step.weights_version.to_string()),
    ];
    Diagnosis {
        level,
        name: "vlaps: drive".into(),
        message: format!("{}: {reason}", driver.word()),
        values,
    }
}

/// What a process says of itself; `Error` when its last message is older than a second.
pub(super) fn process(process: Process, health: &Health, age_ns: u64) -> Diagnosis {
    /// Health comes 20 times a second.
    const SILENT_NS: u64 = 1_000_000_000;
    let state = HealthState::from_code(health.state).map_or("unknown", |state| state.word());
    let is_refused = health.priority == Grant::Refused.code();
    let (level, message) = match age_ns > SILENT_NS {
        true => (Level::Error, "silent".to_string()),
        false if health.late + health.skipped + health.lost > 0 || is_refused => {
            (Level::Warn, state.to_string())
        }
        false => (Level::Ok, state.to_string()),
    };
    let refused: u64 = health.refused.iter().sum();
    Diagnosis {
        level,
        name: format!("vlaps: {}", process.word()),
        message,
        values: vec![
            ("pid", health.header.producer.to_string()),
            ("ticks", health.ticks.to_string()),
            ("late", health.late.to_string()),
            ("skipped", health.skipped.to_string()),
            ("refused", refused.to_string()),
            ("lost", health.lost.to_string()),
        ],
    }
}
