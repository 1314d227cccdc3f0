//! Draws a map, an episode or a plan from above as SVG, and a camera frame as PNG.

pub mod animation;
mod canvas;
mod frame;
mod labels;
pub mod moment;
mod palette;
mod photo;
pub(crate) mod plan;
pub mod raster;
mod ride;
mod roads;
mod tracks;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use clap::builder::{PathBufValueParser, TypedValueParser};
use shm_config::config::Config;
use shm_config::message::{Episode, Observation, Outcome};
use sim::observe::TICK_S;
use sim::{World, WorldConfig};
use supervisor::cli::parsers::whole;

use canvas::Canvas;
use photo::DrawFrame;
use plan::DrawPlan;
use ride::Ride;
use stack::Clock;
use stack::driver::{DriverKind, EpisodeDriver};
use stack::episode::drive;
use supervisor::subcommand::{Configuration, Output, Subcommand, say};

supervisor::subcommands! {
    /// What to draw.
    Draw {
        Map(DrawMap),
        Episode(DrawEpisode),
        Frame(DrawFrame),
        Plan(DrawPlan),
    }
}

/// A map with its route, obstacles and waiting traffic.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  ./vlaps draw map --seed 1000 --set world.sequence=SCrRXTO")]
pub struct DrawMap {
    /// Seed of the map.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Output file; default: map-N.svg.
    #[arg(long, value_name = "FILE.svg", value_parser = ending_in(".svg"))]
    pub out: Option<PathBuf>,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
}

impl Subcommand for DrawMap {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::File("--out", self.out.clone())]
    }

    fn run(&self, _clock: Clock) -> anyhow::Result<ExitCode> {
        let config = self.configuration.resolve()?;
        let mut world = World::new(WorldConfig::from(&config))?;
        world.reset(self.seed)?;
        let file = format!("map-{}.svg", self.seed);
        write(self.out.clone(), &file, &map_svg(&world))?;
        Ok(ExitCode::SUCCESS)
    }
}

/// An episode: path by driver, traffic, contacts, the last scan.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  ./vlaps draw episode --seed 1007 --driver idm --out drive.svg")]
pub struct DrawEpisode {
    /// Seed of the episode.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// The driver.
    #[arg(long, value_name = "DRIVER", default_value = "expert")]
    pub driver: DriverKind,
    /// Output file; default: episode-N-DRIVER.svg.
    #[arg(long, value_name = "FILE.svg", value_parser = ending_in(".svg"))]
    pub out: Option<PathBuf>,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
}

impl Subcommand for DrawEpisode {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::File("--out", self.out.clone())]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let config = self.configuration.resolve()?;
        let file = episode_file(self.seed, self.driver);
        let picture = driven(self.seed, self.driver, &config, clock)?;
        write(self.out.clone(), &file, &picture)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Parses the name of an output file, whose ending must fit the format of the picture.
fn ending_in(ending: &'static str) -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(move |path| {
        let name = path.as_os_str().to_string_lossy().to_ascii_lowercase();
        match name.ends_with(ending) {
            true => Ok(path),
            false => Err(format!("this picture's file must end in {ending}")),
        }
    })
}

/// Draws at most this many failures of an evaluation into a folder.
///
/// # Errors
/// As `map`.
pub fn failures(
    (folder, most): (&Path, usize),
    (seeds, driver): (&[u64], DriverKind),
    config: &Config,
    clock: Clock,
) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    for &seed in seeds.iter().take(most) {
        let picture = driven(seed, driver, config, clock)?;
        let path = folder.join(episode_file(seed, driver));
        write(Some(path), "", &picture)?;
    }
    Ok(())
}

fn episode_file(seed: u64, driver: DriverKind) -> String {
    format!("episode-{seed}-{}.svg", driver.file_word())
}

/// Drives an episode and draws it.
fn driven(seed: u64, driver: DriverKind, config: &Config, clock: Clock) -> anyhow::Result<String> {
    let mut world = World::new(WorldConfig::from(config))?;
    let mut seated = EpisodeDriver::new(driver, config, clock)?;
    world.reset(seed)?;
    let mut ride = Ride::begin(&world);
    let task = (seed, config.run.period_ns());
    let episode = drive(&mut world, &mut seated, task, |tick| ride.watch(tick))?;
    Ok(episode_svg(&world, &ride, &episode, driver.word()))
}

fn write(out: Option<PathBuf>, default: &str, text: &str) -> anyhow::Result<()> {
    let path = out.unwrap_or_else(|| default.into());
    std::fs::write(&path, text).with_context(|| path.display().to_string())?;
    say(path.display());
    Ok(())
}

/// The map of a world in its present state.
pub fn map_svg(world: &World) -> String {
    let map = world.map();
    let letters: Vec<String> = map
        .blocks
        .iter()
        .map(|b| b.kind.letter().to_string())
        .collect();
    let facts = format!(
        "blocks {}   ·   {} lanes of {} m   ·   route {:.0} m over {} roads",
        letters.join(" "),
        world.config().lane_count,
        map.lane_width_m,
        world.route_m(),
        world.navigator().roads().len(),
    );
    let mut canvas = Canvas::around(&map.network);
    roads::draw(&mut canvas, world);
    ride::draw_bodies(&mut canvas, world);
    ride::draw_ego(&mut canvas, world);
    let keys = frame::map_keys(world);
    frame::finish(canvas, &format!("Map {}", map.seed), &facts, &keys)
}

/// The picture of a finished episode.
pub fn episode_svg(world: &World, ride: &Ride, episode: &Episode, driver_name: &str) -> String {
    let mut seen = Observation::default();
    world.observe(&mut seen);
    let outcome = match episode.outcome() {
        Outcome::Arrived if episode.is_strict_success() => "arrived, touched nothing",
        Outcome::Arrived => "arrived, but touched something",
        Outcome::OutOfRoad => "left the road",
        Outcome::MaxStep => "ran out of steps",
        Outcome::Stopped | Outcome::Driving => "stopped",
    };
    let title = format!("Seed {}: {driver_name} {outcome}", episode.seed);
    let seconds = episode.ticks as f64 * TICK_S;
    let facts = format!(
        "{:.1} % of {:.0} m   ·   {seconds:.1} s   ·   {:.1} m/s   ·   in contact with vehicles {:.1} s, with objects {:.1} s",
        episode.completion * 100.0,
        world.route_m(),
        episode.driven_m / seconds.max(TICK_S),
        episode.vehicle_contacts as f64 * TICK_S,
        episode.object_contacts as f64 * TICK_S,
    );
    let mut canvas = Canvas::around(&world.map().network);
    roads::draw(&mut canvas, world);
    ride::draw_scan(&mut canvas, &seen);
    ride.draw_traffic(&mut canvas);
    ride::draw_bodies(&mut canvas, world);
    let mut labels = ride.labels(&canvas, world);
    ride.draw_path(&mut canvas, &mut labels);
    ride::draw_ego(&mut canvas, world);
    ride.draw_contacts(&mut canvas, &mut labels);
    let keys = frame::episode_keys(world, ride, driver_name);
    frame::finish(canvas, &title, &facts, &keys)
}
