//! What `draw` takes.

use std::path::PathBuf;

use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{ArgGroup, Args, Subcommand};
use shm_config::message::{FRAME_SIDES_PX, View};
use shm_config::run::RunName;
use supervisor::cli::parsers::whole;

use super::Configuration;
use crate::seat::DriverKind;

/// What to draw.
#[derive(Debug, Subcommand)]
pub enum Draw {
    /// A map with its route, obstacles and waiting traffic.
    Map(DrawMap),
    /// An episode: who drove where, traffic, contacts, the last scan.
    Episode(DrawEpisode),
    /// What the world's camera sees at a tick: the picture that judges are asked with.
    Frame(DrawFrame),
    /// A plan: the grid, the search tree, the path, the goal.
    Plan(DrawPlan),
}

/// A map with its route, obstacles and waiting traffic.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  ./vlaps draw map --seed 1000 --set world.sequence=SCrRXTO")]
pub struct DrawMap {
    /// Its seed.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// The file to write; without it, map-N.svg.
    #[arg(long, value_name = "FILE.svg", value_parser = ending_in(".svg"))]
    pub out: Option<PathBuf>,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
}

/// An episode: who drove where, traffic, contacts, the last scan.
#[derive(Debug, Args)]
#[command(after_help = "Example:\n  ./vlaps draw episode --seed 1007 --driver idm --out drive.svg")]
pub struct DrawEpisode {
    /// Its seed.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Who drives.
    #[arg(long, value_name = "WHO", default_value = "expert")]
    pub driver: DriverKind,
    /// The file to write; without it, episode-N-WHO.svg.
    #[arg(long, value_name = "FILE.svg", value_parser = ending_in(".svg"))]
    pub out: Option<PathBuf>,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
}

/// What the world's camera sees at a tick: the picture that judges are asked with.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
        ./vlaps draw frame --seed 1000 --tick 120\n  \
        ./vlaps draw frame --seed 1000 --tick 120 --view ego --width 960 --height 720")]
pub struct DrawFrame {
    /// Seed of an episode to drive.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Its tick, from 0.
    #[arg(long, value_name = "T", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub tick: u64,
    /// From where: top_down or ego.
    #[arg(long, value_name = "VIEW", default_value = "top_down", value_parser = view)]
    pub view: View,
    /// Pixels across.
    #[arg(long, value_name = "PX", default_value_t = 480, allow_negative_numbers = true,
          value_parser = side())]
    pub width: u32,
    /// Pixels down.
    #[arg(long, value_name = "PX", default_value_t = 480, allow_negative_numbers = true,
          value_parser = side())]
    pub height: u32,
    /// Who drives.
    #[arg(long, value_name = "WHO", default_value = "expert")]
    pub driver: DriverKind,
    /// The file to write; without it, frame-N-T-VIEW.png.
    #[arg(long, value_name = "FILE.png", value_parser = ending_in(".png"))]
    pub out: Option<PathBuf>,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
}

fn view(text: &str) -> Result<View, String> {
    let known = View::ALL.iter().find(|view| view.word() == text);
    known.copied().ok_or_else(|| {
        let words: Vec<_> = View::ALL.iter().map(|view| view.word()).collect();
        format!("must be {}", words.join(" or "))
    })
}

fn side() -> impl Fn(&str) -> Result<u32, String> + Clone + Send + Sync + 'static {
    let (least, most) = FRAME_SIDES_PX.into_inner();
    whole::<u32>(u64::from(least)..=u64::from(most))
}

/// A picture's file. Its ending says what is in it, and each kind of picture is
/// of one format.
fn ending_in(ending: &'static str) -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(move |path| {
        let name = path.as_os_str().to_string_lossy().to_ascii_lowercase();
        match name.ends_with(ending) {
            true => Ok(path),
            false => Err(format!("this picture's file must end in {ending}")),
        }
    })
}

/// A plan: the grid, the search tree, the path, the goal.
#[derive(Debug, Args)]
#[command(
    group = ArgGroup::new("source").required(true).args(["seed", "scene", "run"]),
    after_help = "From an episode that is driven up to a tick, from a recorded scene, or from a \
        run that is alive: there the newest observation is planned for again, with the run's \
        own configuration.\n\n\
        Examples:\n  \
        ./vlaps draw plan --seed 1000 --tick 120\n  \
        ./vlaps draw plan --scene bench/scenes/built_in.jsonl.gz --index 17 --driver mpc\n  \
        ./vlaps draw plan --run default"
)]
pub struct DrawPlan {
    /// Seed of an episode to drive.
    #[arg(long, value_name = "N", requires = "tick", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: Option<u64>,
    /// Its tick, from 0; of --seed only, a scene is named by --index.
    #[arg(long, value_name = "T", requires = "seed", conflicts_with_all = ["scene", "run"],
          allow_negative_numbers = true, value_parser = whole::<u64>(0..=u64::MAX))]
    pub tick: Option<u64>,
    /// A file of recorded scenes; bench/scenes/README.md describes it.
    #[arg(long, value_name = "FILE")]
    pub scene: Option<PathBuf>,
    /// Which scene of the file, from 0.
    #[arg(long, value_name = "I", default_value_t = 0, requires = "scene",
          conflicts_with_all = ["seed", "run"], allow_negative_numbers = true,
          value_parser = whole::<usize>(0..=u64::MAX))]
    pub index: usize,
    /// Name of a run that is alive; its configuration counts.
    #[arg(long, value_name = "NAME", conflicts_with_all = ["driver", "config", "overrides"])]
    pub run: Option<RunName>,
    /// Who drives, and plans.
    #[arg(long, value_name = "WHO", default_value = "expert")]
    pub driver: DriverKind,
    /// The file to write; without it, plan-SOURCE.svg.
    #[arg(long, value_name = "FILE.svg", value_parser = ending_in(".svg"))]
    pub out: Option<PathBuf>,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
}
