//! Rendering time of the world's camera images.

use std::fmt;

use serde::Serialize;
use shm_config::message::View;
use sim::render::{Renderer, Shot};
use sim::{World, WorldConfig};

use crate::gauges::Gauges;
use lab::report::table;
use stack::lane_keeper::keep_lane;

/// Images of each kind, and ticks between two of them.
const PICTURES: usize = 200;
const APART_TICKS: usize = 10;
/// Measured sizes, pixels: that of a judge's questions, and the largest.
const SIZES_PX: [[u32; 2]; 2] = [[480, 480], [960, 720]];

/// Processor time of the calling thread for one kind of image.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Camera: from the car or from above.
    pub view: &'static str,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Images rendered.
    pub pictures: usize,
    /// Mean, ms.
    pub mean_ms: f64,
    /// 99 % quantile, ms.
    pub p99_ms: f64,
    /// Maximum, ms.
    pub worst_ms: f64,
}

/// Renders images of episodes from `first_seed` on, each kind at the same instants.
///
/// # Errors
/// If a world cannot be made or an image buffer cannot be allocated.
pub fn measure(config: &WorldConfig, first_seed: u64, gauges: Gauges) -> anyhow::Result<Vec<Row>> {
    let views = [View::TopDown, View::Ego];
    let kinds = views.into_iter().flat_map(|view| {
        SIZES_PX.map(|size_px| Shot {
            view,
            size_px,
            passed: 0.0,
        })
    });
    kinds
        .map(|shot| one(config, first_seed, &shot, gauges))
        .collect()
}

fn one(config: &WorldConfig, first_seed: u64, shot: &Shot, gauges: Gauges) -> anyhow::Result<Row> {
    let mut world = World::new(config.clone())?;
    let mut renderer = Renderer::default();
    let mut seed = first_seed;
    world.reset(seed)?;
    renderer.begin(&world);
    let mut observation = Box::default();
    let mut costs_ms = Vec::with_capacity(PICTURES);
    while costs_ms.len() < PICTURES {
        for _ in 0..APART_TICKS {
            world.observe(&mut observation);
            world.step(keep_lane(&observation));
        }
        if world.last_step().has_ended() {
            seed += 1;
            world.reset(seed)?;
            renderer.begin(&world);
        }
        let begun = gauges.core();
        let picture = renderer.draw(&world, shot);
        let picture = picture.ok_or_else(|| anyhow::anyhow!("no memory for an image"))?;
        std::hint::black_box(picture.rgb);
        costs_ms.push((gauges.core() - begun).as_secs_f64() * 1e3);
    }
    costs_ms.sort_by(f64::total_cmp);
    let [width, height] = shot.size_px;
    Ok(Row {
        view: shot.view.word(),
        width,
        height,
        pictures: PICTURES,
        mean_ms: costs_ms.iter().sum::<f64>() / PICTURES as f64,
        p99_ms: costs_ms[PICTURES * 99 / 100 - 1],
        worst_ms: costs_ms[PICTURES - 1],
    })
}

/// The table of the rows.
pub fn printed(rows: &[Row]) -> impl fmt::Display + use<> {
    let mut table = table(&["camera image", "pixels", "mean, ms", "p99", "max"]);
    for row in rows {
        table.add_row([
            row.view.to_string(),
            format!("{} x {}", row.width, row.height),
            format!("{:.2}", row.mean_ms),
            format!("{:.2}", row.p99_ms),
            format!("{:.2}", row.worst_ms),
        ]);
    }
    table
}
