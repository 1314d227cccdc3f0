//! How many ticks of one ego the world makes in a second, with everything on:
//! 240 beams, traffic, obstacles, and the resets between episodes.
//!
//! `cargo run --release -p sim --example sim_speed`

#[path = "../tests/drivers/mod.rs"]
mod drivers;

use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

use shm_config::message::Observation;
use sim::{AfterEnd, Batch, BatchConfig, World, WorldConfig, WorldError};
use vehicle::Action;

const RUN: Duration = Duration::from_secs(5);
const FIRST_SEED: u64 = 1000;

fn main() -> Result<(), WorldError> {
    one_world()?;
    for threads in [1, 2] {
        batch(threads)?;
    }
    Ok(())
}

/// One world on one thread, driven along its lane.
fn one_world() -> Result<(), WorldError> {
    let mut world = World::new(WorldConfig::default())?;
    let mut observation = Observation::default();
    let (mut ticks, mut episodes) = (0_u64, 0_u64);
    let mut reset = Duration::ZERO;
    let mut step = Duration::ZERO;
    let started = Instant::now();
    while started.elapsed() < RUN {
        let before = Instant::now();
        world.reset(FIRST_SEED + episodes % 1000)?;
        reset += before.elapsed();
        let before = Instant::now();
        world.observe(&mut observation);
        while !world.last_step().has_ended() {
            world.step(drivers::keep_lane(&observation));
            world.observe(&mut observation);
            ticks += 1;
        }
        step += before.elapsed();
        episodes += 1;
    }
    let seconds = started.elapsed().as_secs_f64();
    println!(
        "one world: {:.0} ego-steps/s ({ticks} ticks, {episodes} episodes, {seconds:.1} s)",
        ticks as f64 / seconds
    );
    println!(
        "           {:.2} us a tick with observation, {:.0} us a reset",
        step.as_secs_f64() * 1e6 / ticks as f64,
        reset.as_secs_f64() * 1e6 / episodes as f64
    );
    Ok(())
}

/// 64 worlds, begun anew as they end.
fn batch(threads: usize) -> Result<(), WorldError> {
    let worlds = NonZeroUsize::new(64).unwrap_or(NonZeroUsize::MIN);
    let config = BatchConfig {
        worlds,
        threads: NonZeroUsize::new(threads).unwrap_or(NonZeroUsize::MIN),
        after_end: AfterEnd::Restart { stride: 64 },
    };
    let mut batch = Batch::new(&WorldConfig::default(), config, FIRST_SEED)?;
    let mut actions = vec![Action::default(); batch.len()];
    let mut ticks = 0_u64;
    let started = Instant::now();
    while started.elapsed() < RUN {
        batch.visit(|k, report| actions[k] = drivers::keep_lane(report.observation));
        batch.step(&actions)?;
        ticks += actions.len() as u64;
    }
    let seconds = started.elapsed().as_secs_f64();
    println!(
        "64 worlds on {threads} threads: {:.0} ego-steps/s",
        ticks as f64 / seconds
    );
    Ok(())
}
