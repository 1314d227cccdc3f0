//! Which ticks of a recording are drawn, and which driver drove when.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::bail;
use recorder::Recording;
use shm_config::Message as _;
use shm_config::config::{Config, from_toml};
use shm_config::message::{Driver, Header, Step};
use shm_config::services::STEP;
use vehicle::Point;
use view::draw::moment::Band;

use super::Export;

/// The trail has a point each so many metres.
const TRAIL_STEP_M: f64 = 0.5;
/// Frames at most: at 720 x 405 about 100 MB.
const FRAMES_MAX: usize = 10_000;

/// A part of a recorded drive: one episode of one world.
pub type Of = (u32, u32);

/// The episode of a step.
pub fn of(header: &Header) -> Of {
    (header.producer, header.episode)
}

/// A point of the car's path.
#[derive(Clone, Copy, Debug)]
pub struct Passed {
    /// When, s since the recording's beginning.
    pub time_s: f64,
    /// Where.
    pub at_world: Point,
    /// Which driver drove.
    pub driver: Driver,
}

/// A recorded drive, read once.
pub struct Course {
    /// The recording.
    pub recording: Recording,
    /// The configuration as it ran.
    pub config: Config,
    /// Which driver drove when, from the first to the last frame.
    pub band: Band,
    /// The steps that are drawn, by the tick of the controller, in order of time.
    pub frames: Vec<(f64, u64)>,
    /// The path of each episode.
    pub paths: BTreeMap<Of, Vec<Passed>>,
    /// When the recording begins, on the run's clock, ns.
    pub start_ns: u64,
}

/// Whether a step can be drawn: its content is admissible, and it has an observation.
pub fn is_drawn(step: &Step) -> bool {
    step.observation_age_ns != u64::MAX && step.check().is_ok()
}

impl Course {
    /// Reads the steps between two times and chooses those that are drawn.
    ///
    /// # Errors
    /// When the recording cannot be read, or has no step there.
    pub fn read(task: &Export) -> anyhow::Result<Course> {
        let recording = Recording::open(&task.recording)?;
        let config = configuration(&recording, &task.recording)?;
        let (start_ns, end_ns) = recording.span_ns().unwrap_or_default();
        let seconds = |ns: u64| ns.saturating_sub(start_ns) as f64 * 1e-9;
        let to_s = task.to.unwrap_or(f64::INFINITY);
        if to_s <= task.from {
            bail!(
                "--from {} --to {to_s}: the end must be after the beginning",
                task.from
            );
        }
        let mut course = Course {
            config,
            band: Band::default(),
            frames: Vec::new(),
            paths: BTreeMap::new(),
            start_ns,
            recording,
        };
        let from_ns = start_ns.saturating_add((task.from * 1e9) as u64);
        let steps = course.recording.messages(&STEP)?.from_ns(from_ns);
        let apart_s = task.speed / task.fps;
        let mut due_s = task.from;
        for step in steps {
            let step = step?;
            let time_s = seconds(step.header.taken_ns);
            if time_s > to_s {
                break;
            }
            if time_s < task.from || !is_drawn(&step) {
                continue;
            }
            course.pass(&step, time_s);
            // Half a period early is nearer than half a period late.
            if time_s + 0.5 * course.config.run.period_ns() as f64 * 1e-9 >= due_s {
                course.frames.push((time_s, step.header.tick));
                due_s = (due_s + apart_s).max(time_s);
            }
        }
        match course.frames.len() {
            0 => bail!(
                "{}: no step of a controller between {} s and {} s; the recording has {:.1} s",
                task.recording.display(),
                task.from,
                task.to.unwrap_or(seconds(end_ns)),
                seconds(end_ns)
            ),
            1..=FRAMES_MAX => Ok(course),
            many => bail!(
                "{many} pictures are more than {FRAMES_MAX}: raise --speed, lower --fps, or \
                 choose a part with --from and --to"
            ),
        }
    }

    /// Adds a step to the band and the path.
    fn pass(&mut self, step: &Step, time_s: f64) {
        let driver = step.driver();
        match self.band.parts.last_mut() {
            // In a damaged recording time may go back.
            Some((_, to_s, last)) if *last == driver => *to_s = to_s.max(time_s),
            Some((_, to_s, _)) => {
                *to_s = to_s.max(time_s);
                self.band.parts.push((time_s, time_s, driver));
            }
            None => self.band.parts.push((time_s, time_s, driver)),
        }
        let ego = &step.observation.ego;
        let at_world = Point::new(ego.x_world_m, ego.y_world_m);
        let path = self.paths.entry(of(&step.observation.header)).or_default();
        let is_new = path.last().is_none_or(|last| {
            last.driver != driver || (last.at_world - at_world).norm() >= TRAIL_STEP_M
        });
        if is_new {
            path.push(Passed {
                time_s,
                at_world,
                driver,
            });
        }
    }

    /// The path of an episode until a time.
    pub fn trail(&self, of: Of, time_s: f64) -> Vec<(Point, Driver)> {
        let path = self.paths.get(&of).map_or(&[][..], Vec::as_slice);
        let passed = path.iter().take_while(|passed| passed.time_s <= time_s);
        passed
            .map(|passed| (passed.at_world, passed.driver))
            .collect()
    }

    /// The steps that are drawn, in order of time.
    ///
    /// # Errors
    /// When the recording is damaged there.
    pub fn steps(&self) -> impl Iterator<Item = anyhow::Result<(f64, Step)>> {
        let mut wanted = self.frames.iter().peekable();
        let first = self.frames.first().map_or(0, |(_, tick)| *tick);
        let steps = self.recording.messages(&STEP);
        let steps = steps.and_then(|steps| steps.from_tick(first));
        let (mut steps, mut failure) = match steps {
            Ok(steps) => (Some(steps), None),
            Err(error) => (None, Some(error)),
        };
        std::iter::from_fn(move || {
            if let Some(error) = failure.take() {
                return Some(Err(error.into()));
            }
            let (time_s, tick) = **wanted.peek()?;
            let steps = steps.as_mut()?;
            let found = steps.find(|step| {
                let is_it = |step: &Step| step.header.tick == tick && is_drawn(step);
                step.as_ref().map_or(true, is_it)
            })?;
            wanted.next();
            Some(found.map(|step| (time_s, step)).map_err(Into::into))
        })
    }
}

fn configuration(recording: &Recording, path: &Path) -> anyhow::Result<Config> {
    match recording.configuration()? {
        Some(text) => Ok(from_toml(
            &text,
            &format!("{}: config.toml", path.display()),
        )?),
        None => Ok(Config::default()),
    }
}
