//! Cyclone DDS as a program of its own: built on request from `bench/cyclone`.

use std::path::Path;
use std::process::Command;

use anyhow::{Context, bail};
use hdrhistogram::Histogram;
use supervisor::failure::Failure;
use tempfile::TempDir;

use super::{Row, link, period_ns};

/// The sources of `bench/cyclone`.
const SOURCES: [(&str, &str); 2] = [
    ("block.idl", include_str!("../../cyclone/block.idl")),
    ("latency.c", include_str!("../../cyclone/latency.c")),
];
/// Loopback alone: nothing of a measurement leaves the machine.
const CONFIG: &str = "<CycloneDDS><Domain Id=\"any\"><General><Interfaces>\
    <NetworkInterface name=\"lo\" multicast=\"false\"/></Interfaces>\
    <AllowMulticast>false</AllowMulticast></General>\
    <Discovery><ParticipantIndex>auto</ParticipantIndex>\
    <Peers><Peer Address=\"127.0.0.1\"/></Peers></Discovery></Domain></CycloneDDS>";
/// Round trips that are counted, at most: each is a line.
const COUNT_MAX: u64 = 200_000;
/// What a round trip flat out takes, s, to begin with.
const ROUND_S: f64 = 50e-6;

/// The built program; its folder disappears with it.
pub struct Program {
    folder: TempDir,
    /// The library's version.
    pub version: String,
}

/// Builds the program.
///
/// # Errors
/// When a compiler or the library is missing, with what to install.
pub fn build() -> anyhow::Result<Program> {
    let folder = tempfile::tempdir().context("--dds: a folder to build in")?;
    for (name, text) in SOURCES {
        std::fs::write(folder.path().join(name), text).context("--dds: the sources")?;
    }
    let asked = Command::new("pkg-config")
        .args(["--modversion", "CycloneDDS"])
        .output();
    let version = match asked {
        Ok(output) if output.status.success() => {
            String::from_utf8_lossy(&output.stdout).trim().to_string()
        }
        _ => "of unknown version".into(),
    };
    in_folder(folder.path(), "idlc", &["-l", "c", "block.idl"])?;
    let gcc = ["-O2", "latency.c", "block.c", "-o", "latency", "-lddsc"];
    in_folder(folder.path(), "gcc", &gcc)?;
    Ok(Program { folder, version })
}

fn in_folder(folder: &Path, program: &str, words: &[&str]) -> anyhow::Result<()> {
    let built = Command::new(program)
        .current_dir(folder)
        .args(words)
        .output();
    match built {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => Err(Failure::GivenUp(format!(
            "--dds: {program} does not build bench/cyclone; `sudo apt-get install gcc \
             cyclonedds-dev cyclonedds-tools` installs what it needs:\n{}",
            String::from_utf8_lossy(&output.stderr)
        ))
        .into()),
        Err(_) => Err(Failure::GivenUp(format!(
            "--dds: {program} is missing; `sudo apt-get install gcc cyclonedds-dev \
             cyclonedds-tools` installs what it needs"
        ))
        .into()),
    }
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
        let count = match row.rate_hz {
            0 => (seconds / ROUND_S) as u64,
            rate_hz => (seconds * f64::from(rate_hz)).ceil() as u64,
        };
        let count = count.clamp(1, COUNT_MAX);
        let core = |place: usize| cores.get(place).map_or("-1".into(), usize::to_string);
        let output = Command::new(self.folder.path().join("latency"))
            .env("CYCLONEDDS_URI", CONFIG)
            .args([row.message, row.wake])
            .args([period_ns(row.rate_hz), count / 20, count].map(|number| number.to_string()))
            .args([core(0), core(1)])
            .output()
            .context("--dds: the program")?;
        if !output.status.success() {
            bail!(
                "--dds: the program fails ({}): {}",
                output.status,
                String::from_utf8_lossy(&output.stderr)
            );
        }
        let mut all = link::histogram()?;
        for line in String::from_utf8_lossy(&output.stdout).lines() {
            all.saturating_record(line.parse().context("--dds: what the program prints")?);
        }
        if all.len() != count {
            bail!(
                "--dds: asked for {count} round trips, the program did {}",
                all.len()
            );
        }
        Ok(all)
    }
}
