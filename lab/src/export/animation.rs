//! The drive from above as an animated PNG.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use shm_config::message::Step;
use sim::World;
use stack::Clock;
use supervisor::subcommand::say;
use view::draw::animation::{Animation, Format};
use view::draw::moment::{Moment, Shape, draw};
use view::live::scene::Painter;

use super::Export;
use super::course::{Course, of};
use crate::fork::course::{Course as Rebuilding, Until};
use crate::progress::Progress;
use crate::replay::messages::{Taken, taken};
use crate::replay::rebuild::Mover;
use crate::replay::recorded::Recorded;
use crate::replay::worlds::is_built_in;
use crate::stop::Stop;

/// For how long the last picture stays, ms.
const LAST_MS: u16 = 2000;

/// Reports of progress.
const REPORTS: u64 = 20;

/// Writes the animation of a recording.
///
/// # Errors
/// When the recording cannot be read, or the file not be written.
pub fn export(task: &Export, clock: Clock) -> anyhow::Result<()> {
    let stop = Stop::listen()?;
    let path = task.animation_file()?;
    let course = Course::read(task)?;
    course
        .recording
        .damage()
        .for_each(|line| say(format_args!("note: {line}")));
    let part = part_of(&path);
    let written = write(task, &course, &part, (clock, &stop));
    let placed = written.and_then(|()| {
        let name = || format!("--out {}", path.display());
        fs::rename(&part, &path).with_context(name)
    });
    if placed.is_err() {
        // It may not even have been made.
        let _ = fs::remove_file(&part);
    }
    placed?;
    let bytes = fs::metadata(&path).map_or(0, |file| file.len());
    let seconds = course.frames.len() as f64 / task.fps;
    say(format_args!(
        "{}: {} pictures, {seconds:.1} s, {:.2} MB",
        path.display(),
        course.frames.len(),
        bytes as f64 / 1e6
    ));
    Ok(())
}

/// Where a file is written until it is whole, beside its place.
fn part_of(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(".part");
    path.with_file_name(name)
}

/// What draws the frames one after another.
struct Camera<'a> {
    course: &'a Course,
    shape: Shape,
    painter: Painter,
    animation: Animation<BufWriter<File>>,
    progress: Progress,
    drawn: u64,
    /// Pictures between two reports.
    apart: u64,
    stop: &'a Stop,
}

impl Camera<'_> {
    /// Draws a step and adds the frame.
    fn take(&mut self, (time_s, step): (f64, &Step), world: Option<&World>) -> anyhow::Result<()> {
        if self.stop.is_asked() {
            bail!("stopped; no file was written");
        }
        let scene = self.painter.scene(step);
        let trail = self.course.trail(of(&step.observation.header), time_s);
        let moment = Moment {
            step,
            scene: &scene,
            world,
            trail: &trail,
            footprint: self.course.config.vehicle.footprint(),
            time_s,
        };
        let picture = draw(&moment, &self.course.band, self.shape);
        self.animation
            .add(picture.context("no memory for the picture")?)?;
        self.drawn += 1;
        // Not a line for each picture where no bar is shown.
        if self.drawn.is_multiple_of(self.apart) {
            self.progress.at(self.drawn);
        }
        Ok(())
    }
}

fn write(
    task: &Export,
    course: &Course,
    path: &Path,
    (clock, stop): (Clock, &Stop),
) -> anyhow::Result<()> {
    let file = File::create(path).with_context(|| path.display().to_string())?;
    let frames = course.frames.len();
    let format = Format {
        size_px: task.size,
        frames: frames as u32,
        frame_ms: (1000.0 / task.fps).round() as u16,
        last_ms: LAST_MS,
    };
    let name = task.recording.display().to_string();
    let mut camera = Camera {
        course,
        shape: Shape {
            size_px: task.size,
            across_m: task.across,
        },
        painter: Painter::new(&course.config),
        animation: Animation::new(BufWriter::new(file), format),
        progress: Progress::begin(name, "pictures", (0, frames as u64), clock)?,
        drawn: 0,
        apart: (frames as u64 / REPORTS).max(1),
        stop,
    };
    let steps: Vec<(f64, Step)> = course.steps().collect::<anyhow::Result<_>>()?;
    let episode = |step: &Step| of(&step.observation.header);
    for part in steps.chunk_by(|a, b| episode(&a.1) == episode(&b.1)) {
        let before = camera.drawn;
        if let Err(why) = rebuilt(task, course, part, &mut camera)? {
            camera.progress.warn(&format!(
                "the world is not rebuilt, other cars are drawn where they were seen: {why:#}"
            ));
        }
        let done = (camera.drawn - before) as usize;
        for (time_s, step) in &part[done..] {
            camera.take((*time_s, step), None)?;
        }
    }
    camera.progress.end();
    camera.animation.finish()
}

/// Draws the steps of one episode in the rebuilt world; the inner error says from where on it
/// could not be rebuilt.
fn rebuilt(
    task: &Export,
    course: &Course,
    part: &[(f64, Step)],
    camera: &mut Camera,
) -> anyhow::Result<anyhow::Result<()>> {
    let (Some((_, first)), Some((_, last))) = (part.first(), part.last()) else {
        return Ok(Ok(()));
    };
    if !is_built_in(&course.config) {
        return Ok(Err(anyhow::anyhow!("it is not the built-in one")));
    }
    let tick = first.observation.header.tick;
    let read = Recorded::open(&task.recording)
        .and_then(|mut recorded| Rebuilding::read(&mut recorded, tick, Until::Episode));
    let rebuilding = match read {
        Ok(rebuilding) => rebuilding,
        Err(why) => return Ok(Err(why)),
    };
    // Several steps may have one observation.
    let mut wanted: BTreeMap<Taken, Vec<&(f64, Step)>> = BTreeMap::new();
    for pair in part {
        let key = taken(&pair.1.observation.header);
        wanted.entry(key).or_default().push(pair);
    }
    let all = &rebuilding.messages.observations.all;
    let end = taken(&last.observation.header);
    let at = all.iter().position(|seen| taken(&seen.header) == end);
    let mover = Mover::new(&rebuilding.config);
    let mut failure = None;
    let from = rebuilding.beginning(rebuilding.at);
    let span = (from, at.unwrap_or(rebuilding.at));
    let moved = rebuilding.rebuild(&mover, span, |index, rebuilt| {
        let steps = wanted.get(&taken(&all[index].header));
        for (time_s, step) in steps.into_iter().flatten() {
            if failure.is_none() {
                failure = camera.take((*time_s, step), Some(&rebuilt.world)).err();
            }
        }
    });
    match failure {
        Some(failure) => Err(failure),
        None => Ok(moved.map(drop)),
    }
}
