//! The real MetaDrive on one core, as a row beside the built-in world.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, bail};
use serde::Deserialize;
use shm_config::config::Config;
use supervisor::setup::foreign::{METADRIVE, python};

/// Drives MetaDrive and prints its speed as JSON.
const SCRIPT: &str = include_str!("../metadrive_speed.py");

/// What the script measured.
#[derive(Clone, Debug, Deserialize)]
pub struct Measured {
    /// Ticks driven.
    pub steps: u64,
    /// Episodes driven.
    pub episodes: u64,
    /// Wall-clock time, s.
    pub seconds: f64,
    /// Processor time, s.
    pub core_s: f64,
    /// Mean time of a reset, us.
    pub reset_mean_us: f64,
    /// The longest reset, us.
    pub reset_worst_us: f64,
}

/// Result of the attempt.
#[derive(Debug)]
pub enum Attempt {
    /// MetaDrive ran.
    Measured(Measured),
    /// MetaDrive is not installed; the reason.
    Absent(String),
}

/// Drives MetaDrive for about `seconds`.
///
/// # Errors
/// If it is installed but fails.
pub fn measure(
    environment: Option<&Path>,
    config: &Config,
    (first_seed, seconds): (u64, f64),
) -> anyhow::Result<Attempt> {
    let home = match environment {
        Some(folder) => folder.to_path_buf(),
        None => METADRIVE.home()?,
    };
    let interpreter = python(&home);
    if !interpreter.is_file() {
        return Ok(Attempt::Absent(format!(
            "no MetaDrive in {}: ./vlaps setup metadrive makes it",
            home.display()
        )));
    }
    let task = serde_json::json!({
        "world": config.world,
        "scanner": config.scanner,
        "first_seed": first_seed,
        "seconds": seconds,
    });
    let output = Command::new(&interpreter)
        .args(["-c", SCRIPT])
        .arg(METADRIVE.sources()?)
        .arg(task.to_string())
        .stdin(Stdio::null())
        .output()
        .with_context(|| interpreter.display().to_string())?;
    if !output.status.success() {
        let text = String::from_utf8_lossy(&output.stderr);
        let last = text.lines().last().unwrap_or("no error message");
        bail!("MetaDrive in {}: {}: {last}", home.display(), output.status);
    }
    // MetaDrive may print before the JSON object: only the last line counts.
    let text = String::from_utf8_lossy(&output.stdout);
    let last = text.lines().last().unwrap_or_default();
    let measured =
        serde_json::from_str(last).with_context(|| format!("MetaDrive printed {last:?}"))?;
    Ok(Attempt::Measured(measured))
}
