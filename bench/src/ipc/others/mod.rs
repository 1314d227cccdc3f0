//! Other ways from process to process, each as a program of its own that does the
//! same round trips: built on request.

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

/// Round trips that are counted, at most: each is a line.
const COUNT_MAX: u64 = 200_000;
/// What a round trip flat out takes, s, to begin with.
const ROUND_S: f64 = 50e-6;

/// Name and version of what stands beside the wire.
#[derive(Clone, Debug, Serialize)]
pub struct Other {
    /// As the side's name in the table.
    pub name: &'static str,
    /// The library's.
    pub version: String,
}

/// How the message is named to a program.
#[derive(Clone, Copy, Debug)]
enum Message {
    Name,
    Bytes,
}

/// A built program.
pub struct Program {
    /// What it measures.
    pub other: Other,
    binary: PathBuf,
    message: Message,
    environment: Option<(&'static str, &'static str)>,
    /// Where it was built, if that is to disappear with it.
    _folder: Option<TempDir>,
}

/// Builds those that are asked for.
///
/// # Errors
/// When a compiler or a library is missing, with what to install.
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
    /// The same message, rate and receiver as a row's.
    ///
    /// # Errors
    /// When the program fails.
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
            // Ctrl-C in the terminal is ours to act on: it ends in a moment.
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
                .with_context(|| format!("{name}: what its program prints"))?;
            all.saturating_record(ns);
        }
        if all.len() != count {
            bail!(
                "{name}: asked for {count} round trips, its program did {}",
                all.len()
            );
        }
        Ok(all)
    }
}
