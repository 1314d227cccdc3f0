//! What the world's camera sees of an episode's tick.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, anyhow};
use shm_config::message::FRAME_BYTES_MAX;
use sim::render::{Picture, Renderer, Shot};
use sim::{World, WorldConfig};

use crate::arguments::DrawFrame;
use crate::episode::drive;
use crate::report::say;
use crate::seat::Seat;
use crate::{Clock, settings};

/// Drives an episode up to a tick and writes the picture of its observation.
///
/// # Errors
/// When the configuration is wrong, the seed has no map, the episode ends before
/// the tick, the size is none, or the file cannot be written.
pub fn frame(arguments: &DrawFrame, clock: Clock) -> anyhow::Result<()> {
    let DrawFrame {
        seed,
        tick,
        view,
        width,
        height,
        ..
    } = *arguments;
    if width * height * 3 > FRAME_BYTES_MAX as u32 {
        return Err(anyhow!(
            "--width {width} --height {height}: a frame holds {} pixels, as 960 x 720 has",
            FRAME_BYTES_MAX / 3
        ));
    }
    let world = world_at(arguments, clock)?;
    let mut renderer = Renderer::default();
    renderer.begin(&world);
    let shot = Shot {
        view,
        size_px: [width, height],
        passed: 0.0,
    };
    let picture = renderer.draw(&world, &shot).context("no memory")?;
    let default = || format!("frame-{seed}-{tick}-{view}.png").into();
    let path = arguments.out.clone().unwrap_or_else(default);
    write_png(&path, &picture).with_context(|| path.display().to_string())?;
    say(path.display());
    Ok(())
}

/// The world as it is observed at the tick.
fn world_at(arguments: &DrawFrame, clock: Clock) -> anyhow::Result<World> {
    let chosen = &arguments.configuration;
    let config = settings::config(chosen.config.as_deref(), &chosen.overrides)?;
    let config = arguments.driver.configure(&config);
    let mut world = World::new(WorldConfig::from(&config.world))?;
    let (seed, wanted) = (arguments.seed, arguments.tick);
    if wanted == 0 {
        world.reset(seed)?;
        return Ok(world);
    }
    let mut seat = Seat::new(arguments.driver, &config, clock)?;
    let task = (seed, config.run.period_ns());
    let (mut found, mut last) = (None, 0);
    drive(&mut world, &mut seat, task, |tick| {
        if tick.outcome.has_ended() {
            return;
        }
        last = tick.observation.header.tick + 1;
        if last == wanted {
            found = Some(tick.world.clone());
        }
    })?;
    let who = arguments.driver.word();
    found.ok_or_else(|| anyhow!("--tick {wanted}: with {who}, seed {seed} ends at {last}"))
}

fn write_png(path: &Path, picture: &Picture) -> anyhow::Result<()> {
    let [width, height] = picture.size_px;
    let mut encoder = png::Encoder::new(BufWriter::new(File::create(path)?), width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(picture.rgb)?;
    writer.finish()?;
    Ok(())
}
