//! Renders the camera image of a tick of an episode.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, anyhow};
use clap::Args;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use shm_config::message::{FRAME_BYTES_MAX, FRAME_SIDES_PX, View};
use sim::render::{Picture, Renderer, Shot};
use sim::{World, WorldConfig};

use stack::episode::drive;
use supervisor::cli::parsers::whole;
use supervisor::subcommand::{Configuration, Output, Subcommand, say};

use super::ending_in;
use stack::Clock;
use stack::driver::{DriverKind, EpisodeDriver};

/// A camera image at a tick, as judges receive it.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
        ./vlaps draw frame --seed 1000 --tick 120\n  \
        ./vlaps draw frame --seed 1000 --tick 120 --view ego --width 960 --height 720")]
pub struct DrawFrame {
    /// Seed of the episode.
    #[arg(long, value_name = "N", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Tick of the episode, from 0.
    #[arg(long, value_name = "T", allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub tick: u64,
    /// Camera: top_down or ego.
    #[arg(long, value_name = "VIEW", default_value = "top_down", value_parser = view)]
    pub view: View,
    /// Width, pixels.
    #[arg(long, value_name = "PX", default_value_t = 480, allow_negative_numbers = true,
          value_parser = side())]
    pub width: u32,
    /// Height, pixels.
    #[arg(long, value_name = "PX", default_value_t = 480, allow_negative_numbers = true,
          value_parser = side())]
    pub height: u32,
    /// The driver.
    #[arg(long, value_name = "DRIVER", default_value = "expert")]
    pub driver: DriverKind,
    /// Output file; default: frame-N-T-VIEW.png.
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

impl Subcommand for DrawFrame {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::File("--out", self.out.clone())]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let DrawFrame {
            seed,
            tick,
            view,
            width,
            height,
            ..
        } = *self;
        if width * height * 3 > FRAME_BYTES_MAX as u32 {
            return Err(anyhow!(
                "--width {width} --height {height}: a frame has at most {} pixels, such as 960 x 720",
                FRAME_BYTES_MAX / 3
            ));
        }
        let world = world_at(self, clock)?;
        let mut renderer = Renderer::default();
        renderer.begin(&world);
        let shot = Shot {
            view,
            size_px: [width, height],
            passed: 0.0,
        };
        let picture = renderer
            .draw(&world, &shot)
            .context("no memory for the picture")?;
        let default = || format!("frame-{seed}-{tick}-{view}.png").into();
        let path = self.out.clone().unwrap_or_else(default);
        write_png(&path, &picture).with_context(|| path.display().to_string())?;
        say(path.display());
        Ok(ExitCode::SUCCESS)
    }
}

/// The world as it is at the tick's observation.
fn world_at(arguments: &DrawFrame, clock: Clock) -> anyhow::Result<World> {
    let config = arguments.configuration.resolve()?;
    let config = arguments.driver.configure(&config);
    let mut world = World::new(WorldConfig::from(&config))?;
    let (seed, wanted) = (arguments.seed, arguments.tick);
    if wanted == 0 {
        world.reset(seed)?;
        return Ok(world);
    }
    let mut driver = EpisodeDriver::new(arguments.driver, &config, clock)?;
    let task = (seed, config.run.period_ns());
    let (mut found, mut last) = (None, 0);
    drive(&mut world, &mut driver, task, |tick| {
        if tick.outcome.has_ended() {
            return;
        }
        last = tick.observation.header.tick + 1;
        if last == wanted {
            found = Some(tick.world.clone());
        }
    })?;
    let driver = arguments.driver.word();
    found.ok_or_else(|| anyhow!("--tick {wanted}: with {driver}, seed {seed} ends at {last}"))
}

fn write_png(path: &Path, picture: &Picture) -> anyhow::Result<()> {
    let [width, height] = picture.size_px;
    let encoder = PngEncoder::new(BufWriter::new(File::create(path)?));
    encoder.write_image(picture.rgb, width, height, ExtendedColorType::Rgb8)?;
    Ok(())
}
