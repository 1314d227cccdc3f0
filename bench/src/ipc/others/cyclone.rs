//! Builds the program of `bench/cyclone` with Cyclone DDS.

use std::path::Path;
use std::process::Command;

use anyhow::Context;
use supervisor::cli::failure::Failure;

use super::{Message, Other, Program};

/// The sources of `bench/cyclone`.
const SOURCES: [(&str, &str); 2] = [
    ("block.idl", include_str!("../../../cyclone/block.idl")),
    ("latency.c", include_str!("../../../cyclone/latency.c")),
];
/// Uses the loopback interface only: no message leaves the machine.
const CONFIG: &str = "<CycloneDDS><Domain Id=\"any\"><General><Interfaces>\
    <NetworkInterface name=\"lo\" multicast=\"false\"/></Interfaces>\
    <AllowMulticast>false</AllowMulticast></General>\
    <Discovery><ParticipantIndex>auto</ParticipantIndex>\
    <Peers><Peer Address=\"127.0.0.1\"/></Peers></Discovery></Domain></CycloneDDS>";
/// Builds the program.
///
/// # Errors
/// If a compiler or the library is missing; the message says what to install.
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
    Ok(Program {
        other: Other {
            name: "cyclone dds",
            version,
        },
        binary: folder.path().join("latency"),
        message: Message::Name,
        environment: Some(("CYCLONEDDS_URI", CONFIG)),
        _folder: Some(folder),
    })
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
