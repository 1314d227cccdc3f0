//! How many ticks of one ego the world makes in a second, with everything on:
//! 240 beams, traffic, obstacles, and the resets between episodes.
//!
//! Beside the wall clock it counts the thread's own processor time, which says
//! what one core does when other work shares it.
//!
//! `cargo run --release -p sim --example sim_speed`

// A measurement reads the clock.
#![allow(clippy::disallowed_methods)]

#[path = "../tests/drivers/mod.rs"]
mod drivers;

use std::num::NonZeroUsize;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};
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

/// Processor time of this thread so far, s.
fn core_s() -> f64 {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

/// One world on one thread, driven along its lane.
fn one_world() -> Result<(), WorldError> {
    let mut world = World::new(WorldConfig::default())?;
    let mut observation = Observation::default();
    let (mut ticks, mut episodes) = (0_u64, 0_u64);
    let mut reset_s = 0.0;
    let started = Instant::now();
    let core_before_s = core_s();
    while started.elapsed() < RUN {
        let before_s = core_s();
        world.reset(FIRST_SEED + episodes % 1000)?;
        reset_s += core_s() - before_s;
        world.observe(&mut observation);
        while !world.last_step().has_ended() {
            world.step(drivers::keep_lane(&observation));
            world.observe(&mut observation);
            ticks += 1;
        }
        episodes += 1;
    }
    let seconds = started.elapsed().as_secs_f64();
    let core_seconds = core_s() - core_before_s;
    println!(
        "one world: {:.0} ego-steps per core-second, {:.0} per second \
         ({ticks} ticks, {episodes} episodes in {seconds:.1} s)",
        ticks as f64 / core_seconds,
        ticks as f64 / seconds
    );
    println!(
        "           {:.2} us a tick with observation, {:.0} us a reset (core time)",
        (core_seconds - reset_s) * 1e6 / ticks as f64,
        reset_s * 1e6 / episodes as f64
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
