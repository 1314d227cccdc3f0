//! Other transports, each a separate program that makes the same round trips and is
//! built on request.

mod cyclone;
mod zenoh;

use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, bail};
use hdrhistogram::Histogram;
use serde::Serialize;
use tempfile::TempDir;

use super::arguments::BenchIpc;
use super::{Row, link, period_ns};

/// Maximum number of counted round trips: each prints a line.
const COUNT_MAX: u64 = 200_000;
/// Initial estimate of the time of a round trip, s.
const ROUND_S: f64 = 50e-6;

/// Name and version of another transport.
#[derive(Clone, Debug, Serialize)]
pub struct Other {
    /// Name of its side in the table.
    pub name: &'static str,
    /// Version of the library.
    pub version: String,
}

/// How the message is passed to the program.
#[derive(Clone, Copy, Debug)]
enum Message {
    Name,
    Bytes,
}

/// A built program.
pub struct Program {
    /// The transport that it measures.
    pub other: Other,
    binary: PathBuf,
    message: Message,
    environment: Option<(&'static str, &'static str)>,
    /// The build folder, if it is temporary.
    _folder: Option<TempDir>,
}

/// Builds the requested programs.
///
/// # Errors
/// If a compiler or a library is missing; the message says what to install.
pub fn build(arguments: &BenchIpc) -> anyhow::Result<Vec<Program>> {
    let mut programs = Vec::new();
    if arguments.dds {
        programs.push(cyclone::build()?);
    }
    if arguments.zenoh {
        programs.push(zenoh::build()?);
    }
    Ok(programs)
}

impl Program {
    /// Measures a row with the same message size, rate and receiver.
    ///
    /// # Errors
    /// If the program fails.
    pub fn measure(
        &self,
        row: &Row,
        cores: &[usize],
        seconds: f64,
    ) -> anyhow::Result<Histogram<u64>> {
        let name = self.other.name;
        let count = match row.rate_hz {
            0 => (seconds / ROUND_S) as u64,
            rate_hz => (seconds * f64::from(rate_hz)).ceil() as u64,
        };
        let count = count.clamp(1, COUNT_MAX);
        let core = |place: usize| cores.get(place).map_or("-1".into(), usize::to_string);
        let message = match self.message {
            Message::Name => row.message.to_string(),
            Message::Bytes => row.bytes.to_string(),
        };
        let output = Command::new(&self.binary)
            .envs(self.environment)
            .args([message.as_str(), row.wake])
            .args([period_ns(row.rate_hz), count / 20, count].map(|number| number.to_string()))
            .args([core(0), core(1)])
            // Ctrl-C in the terminal is handled here; the program ends soon by itself.
            .process_group(0)
            .output()
            .with_context(|| format!("{name}: its program"))?;
        if !output.status.success() {
            bail!(
                "{name}: its program fails ({}): {}",
                output.status,
                String::from_utf8_lossy(&output.stderr)
            );
        }
        let mut all = link::histogram()?;
        for line in String::from_utf8_lossy(&output.stdout).lines() {
            let ns = line
                .parse()
                .with_context(|| format!("{name}: unexpected output of its program"))?;
            all.saturating_record(ns);
        }
        if all.len() != count {
            bail!(
                "{name}: requested {count} round trips, its program made {}",
                all.len()
            );
        }
        Ok(all)
    }
}
