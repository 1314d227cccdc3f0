//! How many ticks of one ego a second: 240 beams, traffic, obstacles, resets
//! and a scripted driver included; ours beside MetaDrive's.

use crate::gauges::Gauges;
use clap::Args;
use stack::Clock;
use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;
use supervisor::cli::parsers::whole;
use supervisor::subcommand::{Output, Subcommand, seconds};

use serde::Serialize;
use shm_config::config::Config;
use shm_config::message::Observation;
use sim::{AfterEnd, Batch, BatchConfig, World, WorldConfig};
use vehicle::Action;

use crate::batches;
use crate::metadrive::{Attempt, Measured, measure};
use crate::photography;
use lab::report::{Machine, table};
use stack::lane_keeper::keep_lane;
use supervisor::subcommand::{say, write_json_option};

/// Measure how fast the built-in world is, beside MetaDrive.
#[derive(Debug, Args)]
#[command(
    after_help = "Everything is on: 240 beams, traffic, obstacles, resets, and a driver that \
        keeps its lane. MetaDrive runs on one core in the same run when \
        `./vlaps setup metadrive` has made its virtual environment.\n\n\
        Example:\n  ./vlaps bench sim --seconds 10 --json sim.json"
)]
pub struct Sim {
    /// Seconds for each row.
    #[arg(long, value_name = "S", default_value_t = 5.0, allow_negative_numbers = true,
          value_parser = seconds)]
    pub seconds: f64,
    /// Seed of the first episode.
    #[arg(long, value_name = "N", default_value_t = 1000, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// The virtual environment with MetaDrive, if not the one that
    /// `./vlaps setup metadrive` makes.
    #[arg(long, value_name = "DIR")]
    pub metadrive: Option<PathBuf>,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for Sim {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let gauges = Gauges::new(clock);
        let config = Config::default();
        let world = WorldConfig::from(&config);
        let machine = Machine::here()?;
        let cores = std::thread::available_parallelism()?;
        let conditions = Conditions {
            seconds: self.seconds,
            beams: config.scanner.beams,
            machine,
        };
        let first_seed = self.first_seed;
        let bytes_per_world = bytes_per_world(&world, first_seed, gauges)?;
        let ours = one_core(&world, (first_seed, self.seconds), gauges)?;
        let one_per_s = ours.ego_steps_per_s;
        let mut rows = vec![ours];
        let task = (first_seed, self.seconds);
        let attempt = measure(self.metadrive.as_deref(), &config, task)?;
        let mut times_metadrive = None;
        if let Attempt::Measured(measured) = &attempt {
            let row = metadrive_row(measured);
            times_metadrive = Some(one_per_s / row.ego_steps_per_s);
            rows.push(row);
        }
        rows.insert(1, without_driver(&world, task, gauges)?);
        rows.push(all_cores(&world, task, cores, gauges)?);
        for worlds in BATCHES {
            for threads in BTreeSet::from([NonZeroUsize::MIN, cores]) {
                rows.push(batch(&world, task, (worlds, threads), gauges)?);
            }
        }
        let speed = Speed {
            rows,
            shared: batches::measure(&world, task, gauges)?,
            frames: photography::measure(&world, first_seed, gauges)?,
            bytes_per_world,
            times_metadrive,
            conditions,
        };
        print(&speed);
        if let Attempt::Absent(reason) = attempt {
            say(format_args!("MetaDrive left out: {reason}"));
        }
        write_json_option(&self.json, &speed)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Seeds are used again after this many.
const SEEDS: u64 = 1000;
/// Worlds of a batch.
const BATCHES: [NonZeroUsize; 2] = [
    NonZeroUsize::new(64).unwrap(),
    NonZeroUsize::new(256).unwrap(),
];
/// Episodes whose actions are recorded, to be driven again without a driver.
const RECORDED: u64 = 40;
/// Episodes over which the memory of a world is watched.
const MEMORY_EPISODES: u64 = 200;
/// The project's bars: on one core, and as a multiple of MetaDrive's.
const BAR_PER_S: f64 = 50_000.0;
const BAR_TIMES: f64 = 100.0;

/// One measurement.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// What ran.
    pub what: String,
    /// On how many threads.
    pub threads: usize,
    /// Ticks of one ego, by the wall clock.
    pub ego_steps_per_s: f64,
    /// Ticks by processor time: what a core does when nothing shares it. In a batch, by
    /// the time of its calls and by thread, without the driver, which the caller is.
    pub ego_steps_per_s_per_core: Option<f64>,
    /// Mean of a reset, us.
    pub reset_mean_us: Option<f64>,
    /// The longest reset, us.
    pub reset_worst_us: Option<f64>,
    /// Episodes begun.
    pub episodes: u64,
}

/// All measurements of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Speed {
    /// The table's rows.
    pub rows: Vec<Row>,
    /// Bytes that one world holds with its observation.
    pub bytes_per_world: BytesPerWorld,
    /// What worlds lose in a batch.
    pub shared: Vec<batches::Row>,
    /// What a picture costs.
    pub frames: Vec<photography::Row>,
    /// Ours on one core over MetaDrive's on one core; none when it was absent.
    pub times_metadrive: Option<f64>,
    /// How it was measured.
    pub conditions: Conditions,
}

/// Memory of one world, over many episodes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct BytesPerWorld {
    /// On average.
    pub mean: usize,
    /// At most.
    pub worst: usize,
}

/// How it was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Conditions {
    /// Seconds for each row.
    pub seconds: f64,
    /// Lidar beams.
    pub beams: u32,
    /// Where.
    #[serde(flatten)]
    pub machine: Machine,
}

/// What one thread did.
#[derive(Clone, Copy, Default)]
struct Work {
    ticks: u64,
    episodes: u64,
    core_s: f64,
    reset_s: f64,
    reset_worst_s: f64,
}

fn print(speed: &Speed) {
    let Conditions {
        seconds,
        beams,
        machine,
    } = &speed.conditions;
    say(format_args!(
        "{beams} beams, traffic, obstacles, resets, lane keeper; {seconds} s a row, {machine}"
    ));
    let mut table = table(&[
        "",
        "ego-steps/s",
        "per core-second",
        "reset mean, us",
        "worst",
        "episodes",
    ]);
    let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.0}"));
    for row in &speed.rows {
        table.add_row([
            row.what.clone(),
            number(Some(row.ego_steps_per_s)),
            number(row.ego_steps_per_s_per_core),
            number(row.reset_mean_us),
            number(row.reset_worst_us),
            row.episodes.to_string(),
        ]);
    }
    say(table);
    say(batches::printed(&speed.shared));
    let BytesPerWorld { mean, worst } = speed.bytes_per_world;
    let word = |met: bool| if met { "met" } else { "MISSED" };
    if let Some(ours) = speed.rows.first() {
        let rate = ours.ego_steps_per_s;
        let met = word(rate > BAR_PER_S);
        say(format_args!(
            "one core: {rate:.0} ego-steps/s, bar {BAR_PER_S}: {met}"
        ));
    }
    if let Some(times) = speed.times_metadrive {
        let met = word(times > BAR_TIMES);
        say(format_args!(
            "one core: {times:.0} times MetaDrive, bar {BAR_TIMES}: {met}"
        ));
    }
    say(format_args!(
        "memory of a world: {} KiB on average, {} KiB at most over {MEMORY_EPISODES} episodes",
        mean.div_ceil(1024),
        worst.div_ceil(1024)
    ));
    say(photography::printed(&speed.frames));
}

impl Work {
    /// Begins an episode, and measures how long that takes.
    fn reset(&mut self, world: &mut World, seed: u64, gauges: Gauges) -> anyhow::Result<()> {
        let before = gauges.core();
        world.reset(seed)?;
        let reset_s = (gauges.core() - before).as_secs_f64();
        self.reset_s += reset_s;
        self.reset_worst_s = self.reset_worst_s.max(reset_s);
        self.episodes += 1;
        Ok(())
    }
}

/// Drives episodes on this thread until the time is up.
fn drive(
    config: &WorldConfig,
    (first_seed, seconds): (u64, f64),
    gauges: Gauges,
) -> anyhow::Result<Work> {
    let mut world = World::new(config.clone())?;
    let mut observation = Box::<Observation>::default();
    let mut work = Work::default();
    let begun = gauges.now();
    let core_begun = gauges.core();
    while (gauges.now().since_ns(begun) as f64) < seconds * 1e9 {
        work.reset(&mut world, first_seed + work.episodes % SEEDS, gauges)?;
        world.observe(&mut observation);
        while !world.last_step().has_ended() {
            world.step(keep_lane(&observation));
            world.observe(&mut observation);
            work.ticks += 1;
        }
    }
    work.core_s = (gauges.core() - core_begun).as_secs_f64();
    Ok(work)
}

fn row(what: String, threads: usize, works: &[Work], seconds: f64) -> Row {
    let sum = |of: fn(&Work) -> f64| works.iter().map(of).sum::<f64>();
    let ticks = sum(|work| work.ticks as f64);
    let episodes: u64 = works.iter().map(|work| work.episodes).sum();
    let worst_s = works.iter().map(|work| work.reset_worst_s);
    Row {
        what,
        threads,
        ego_steps_per_s: ticks / seconds,
        ego_steps_per_s_per_core: Some(ticks / sum(|work| work.core_s)),
        reset_mean_us: Some(sum(|work| work.reset_s) * 1e6 / episodes.max(1) as f64),
        reset_worst_us: Some(worst_s.fold(0.0, f64::max) * 1e6),
        episodes,
    }
}

fn one_core(config: &WorldConfig, task: (u64, f64), gauges: Gauges) -> anyhow::Result<Row> {
    let begun = gauges.now();
    let work = drive(config, task, gauges)?;
    let seconds = gauges.now().since_ns(begun) as f64 * 1e-9;
    Ok(row("VLAPS, one core".into(), 1, &[work], seconds))
}

fn all_cores(
    config: &WorldConfig,
    (first_seed, seconds): (u64, f64),
    cores: NonZeroUsize,
    gauges: Gauges,
) -> anyhow::Result<Row> {
    let begun = gauges.now();
    let works: anyhow::Result<Vec<Work>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..cores.get() as u64)
            .map(|k| {
                let task = (first_seed + k * SEEDS, seconds);
                scope.spawn(move || drive(config, task, gauges))
            })
            .collect();
        let join = |thread: std::thread::ScopedJoinHandle<_>| match thread.join() {
            Ok(work) => work,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        threads.into_iter().map(join).collect()
    });
    let elapsed_s = gauges.now().since_ns(begun) as f64 * 1e-9;
    let what = format!("VLAPS, all {cores} cores");
    Ok(row(what, cores.get(), &works?, elapsed_s))
}

/// The actions of the lane keeper in the first episodes.
fn recorded(config: &WorldConfig, first_seed: u64) -> anyhow::Result<Vec<Vec<Action>>> {
    let mut world = World::new(config.clone())?;
    let mut observation = Box::<Observation>::default();
    let mut episodes = Vec::new();
    for seed in first_seed..first_seed + RECORDED {
        let mut actions = Vec::new();
        world.reset(seed)?;
        while !world.last_step().has_ended() {
            world.observe(&mut observation);
            let action = keep_lane(&observation);
            actions.push(action);
            world.step(action);
        }
        episodes.push(actions);
    }
    Ok(episodes)
}

/// The same episodes again and again, on this thread: resets, ticks and observations.
/// What a batch does in its calls, so the two compare.
fn without_driver(
    config: &WorldConfig,
    (first_seed, seconds): (u64, f64),
    gauges: Gauges,
) -> anyhow::Result<Row> {
    let episodes = recorded(config, first_seed)?;
    let mut world = World::new(config.clone())?;
    let mut observation = Box::<Observation>::default();
    let mut work = Work::default();
    let begun = gauges.now();
    let core_begun = gauges.core();
    while (gauges.now().since_ns(begun) as f64) < seconds * 1e9 {
        let episode = work.episodes % RECORDED;
        work.reset(&mut world, first_seed + episode, gauges)?;
        for &action in &episodes[episode as usize] {
            world.step(action);
            world.observe(&mut observation);
            work.ticks += 1;
        }
    }
    work.core_s = (gauges.core() - core_begun).as_secs_f64();
    let elapsed_s = gauges.now().since_ns(begun) as f64 * 1e-9;
    Ok(row(
        "VLAPS, one core, without its driver".into(),
        1,
        &[work],
        elapsed_s,
    ))
}

/// Worlds in step, as a learner drives them; actions are chosen by the caller.
fn batch(
    config: &WorldConfig,
    (first_seed, seconds): (u64, f64),
    (worlds, threads): (NonZeroUsize, NonZeroUsize),
    gauges: Gauges,
) -> anyhow::Result<Row> {
    let stride = worlds.get() as u64;
    let settings = BatchConfig {
        worlds,
        threads,
        after_end: AfterEnd::Restart { stride },
    };
    let mut batch = Batch::new(config, settings, first_seed)?;
    let mut actions = vec![Action::default(); batch.len()];
    let (mut ticks, mut episodes) = (0_u64, stride);
    let begun = gauges.now();
    let (mut elapsed_s, mut calls_s) = (0.0, 0.0);
    while elapsed_s < seconds {
        batch.visit(|k, report| {
            actions[k] = keep_lane(report.observation);
            episodes += u64::from(report.outcome.has_ended());
        });
        let called = gauges.now();
        batch.step(&actions)?;
        calls_s += gauges.now().since_ns(called) as f64 * 1e-9;
        ticks += stride;
        elapsed_s = gauges.now().since_ns(begun) as f64 * 1e-9;
    }
    let ticks = ticks as f64;
    Ok(Row {
        what: format!("VLAPS, batch of {worlds}, {threads} threads"),
        threads: threads.get(),
        ego_steps_per_s: ticks / elapsed_s,
        ego_steps_per_s_per_core: Some(ticks / calls_s / threads.get() as f64),
        reset_mean_us: None,
        reset_worst_us: None,
        episodes,
    })
}

fn metadrive_row(measured: &Measured) -> Row {
    let steps = measured.steps as f64;
    Row {
        what: "MetaDrive, one core".into(),
        threads: 1,
        ego_steps_per_s: steps / measured.seconds,
        ego_steps_per_s_per_core: Some(steps / measured.core_s),
        reset_mean_us: Some(measured.reset_mean_us),
        reset_worst_us: Some(measured.reset_worst_us),
        episodes: measured.episodes,
    }
}

/// What one world and its observation add to the heap. Nothing else runs.
fn bytes_per_world(
    config: &WorldConfig,
    first_seed: u64,
    gauges: Gauges,
) -> anyhow::Result<BytesPerWorld> {
    let before = gauges.bytes_held();
    let mut world = Box::new(World::new(config.clone())?);
    let mut observation = Box::<Observation>::default();
    let (mut sum, mut worst) = (0, 0);
    for seed in first_seed..first_seed + MEMORY_EPISODES {
        world.reset(seed)?;
        while !world.last_step().has_ended() {
            world.observe(&mut observation);
            world.step(keep_lane(&observation));
        }
        let held = gauges.bytes_held().saturating_sub(before);
        sum += held;
        worst = worst.max(held);
    }
    Ok(BytesPerWorld {
        mean: sum / MEMORY_EPISODES as usize,
        worst,
    })
}
