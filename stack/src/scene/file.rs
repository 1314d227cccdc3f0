//! A file of scenes: lines of JSON, compressed by gzip or not.

use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::path::Path;

use anyhow::{Context, anyhow, bail};
use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use shm_config::file::{Durable, replace};

use super::Scene;
use super::line::Line;

/// A line is no longer than this, bytes: ten times a scene of 512 beams.
const LINE_MAX: u64 = 256 * 1024;
/// Most scenes of a file.
const SCENES_MAX: usize = 1_000_000;

/// The checked-in scenes.
pub const CHECKED_IN_NAME: &str = "stack/scenes/built_in.jsonl.gz";
const CHECKED_IN: &[u8] = include_bytes!("../../scenes/built_in.jsonl.gz");

/// How every gzip file begins.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Reads all scenes of a file.
///
/// # Errors
/// When it cannot be read, holds no scene, is cut off, or a line is wrong; the
/// error names line and field.
pub fn read(path: &Path) -> anyhow::Result<Vec<Scene>> {
    let name = path.display();
    let file = File::open(path).with_context(|| name.to_string())?;
    parse(BufReader::new(file), &name.to_string())
}

/// The scenes of this repository, recorded with training seeds.
///
/// # Errors
/// Only when the checked-in file is broken.
pub fn checked_in() -> anyhow::Result<Vec<Scene>> {
    parse(CHECKED_IN, CHECKED_IN_NAME)
}

fn parse(mut file: impl BufRead, name: &str) -> anyhow::Result<Vec<Scene>> {
    let is_gzip = file
        .fill_buf()
        .with_context(|| name.to_string())?
        .starts_with(&GZIP);
    let mut text: Box<dyn BufRead> = match is_gzip {
        true => Box::new(BufReader::new(MultiGzDecoder::new(file))),
        false => Box::new(file),
    };
    let mut scenes = Vec::new();
    let mut line = String::new();
    for number in 1.. {
        line.clear();
        let read = (&mut text).take(LINE_MAX).read_line(&mut line);
        let length = read.map_err(|error| match error.kind() {
            ErrorKind::UnexpectedEof => anyhow!("{name}: cut off in line {number}"),
            _ => anyhow!("{name}: line {number}: {error}"),
        })?;
        if length == 0 {
            break;
        }
        if length as u64 == LINE_MAX {
            bail!("{name}: line {number}: longer than {LINE_MAX} bytes");
        }
        if scenes.len() == SCENES_MAX {
            bail!("{name}: line {number}: more than {SCENES_MAX} scenes");
        }
        let scene = Line::parse(line.trim_end())
            .map_err(|error| anyhow!("{name}: line {number}: {error}"))?;
        scenes.push(scene);
    }
    if scenes.is_empty() {
        bail!("{name}: no scene in it; `./vlaps bench planner --record FILE` records some");
    }
    Ok(scenes)
}

/// Writes scenes to a file, compressed when its name ends in `.gz`. The file
/// appears whole or not at all.
///
/// # Errors
/// When it cannot be written.
pub fn write(path: &Path, scenes: &[Scene]) -> anyhow::Result<()> {
    let mut text = Vec::new();
    for scene in scenes {
        serde_json::to_writer(&mut text, &Line::new(scene)).context("a scene")?;
        text.push(b'\n');
    }
    if path.extension().is_some_and(|extension| extension == "gz") {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(&text)?;
        text = encoder.finish()?;
    }
    replace(path, &text, Durable::Yes).with_context(|| path.display().to_string())
}
