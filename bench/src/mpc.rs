//! A long, disturbed drive of the model-predictive expert: walls block the road and
//! random commands replace the planned ones. It checks that every problem is solved,
//! and in time.

use crate::gauges::Gauges;
use clap::Args;
use hdrhistogram::Histogram;
use indicatif::{ProgressBar, ProgressStyle};
use planner::Mpc;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::Serialize;
use shm_config::counted;
use shm_config::message::{Header, Observation, Plan};
use sim::{World, WorldConfig};
use stack::Clock;
use std::path::PathBuf;
use std::process::ExitCode;
use supervisor::cli::parsers::whole;
use supervisor::subcommand::{Configuration, Output, Subcommand};
use vehicle::{Action, Pose, pose};

use lab::report::{Machine, table};
use stack::driver::planning_histogram;
use supervisor::subcommand::{say, write_json_option};

/// Drive the model-predictive expert under disturbances and measure its solve time.
#[derive(Debug, Args)]
#[command(
    after_help = "A third of the time the road is free, a third of the time a wall blocks it, and a \
        third of the time random commands replace those of the plan.\n\n\
        Examples:\n  \
        ./vlaps bench mpc --json mpc.json\n  \
        ./vlaps bench mpc --ticks 2000 --set mpc.steps=16"
)]
pub struct BenchMpc {
    /// Number of ticks.
    #[arg(long, value_name = "N", default_value_t = 100_000,
          allow_negative_numbers = true,
          value_parser = whole::<u64>(1..=100_000_000))]
    pub ticks: u64,
    /// Seed of the first episode, and of the disturbances.
    #[arg(long, value_name = "N", default_value_t = 100, allow_negative_numbers = true,
          value_parser = whole::<u64>(0..=u64::MAX))]
    pub first_seed: u64,
    /// Configuration and overrides.
    #[command(flatten)]
    pub configuration: Configuration,
    /// Also write the figures to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

impl Subcommand for BenchMpc {
    fn outputs(&self) -> Vec<Output> {
        vec![Output::json(&self.json)]
    }

    fn run(&self, clock: Clock) -> anyhow::Result<ExitCode> {
        let gauges = Gauges::new(clock);
        let config = self.configuration.resolve()?;
        let period_ns = config.run.period_ns();
        let mut world = World::new(WorldConfig::from(&config))?;
        let mut drive = DisturbedDrive {
            planner: Mpc::new(&config),
            plan: Plan::default(),
            dice: Xoshiro256PlusPlus::seed_from_u64(self.first_seed),
            wall_world: None,
            tallies: Condition::ALL.map(|_| Tally::new()),
            gauges,
            period_ns,
        };
        let bar = ProgressBar::new(self.ticks);
        bar.set_style(ProgressStyle::with_template(
            "{elapsed_precise} {wide_bar} {pos}/{len} ticks, {eta} left",
        )?);
        let mut observation = Box::<Observation>::default();
        let (mut condition, mut seed) = (Condition::Free, self.first_seed);
        world.reset(seed)?;
        let mut episode_tick = 0;
        for tick in 0..self.ticks {
            if world.last_step().has_ended() {
                seed = seed.wrapping_add(1);
                world.reset(seed)?;
                episode_tick = 0;
                drive.planner.forget();
            }
            world.observe(&mut observation);
            observation.header = Header {
                tick: episode_tick,
                taken_ns: episode_tick * period_ns,
                ..Header::default()
            };
            if tick % CONDITION_TICKS == 0 {
                condition = Condition::ALL[drive.below(Condition::ALL.len() as u64) as usize];
                drive.begin(condition, world.world_from_ego());
            }
            let action = drive.tick(condition, tick % CONDITION_TICKS, &world, &mut observation);
            world.step(action);
            episode_tick += 1;
            bar.inc(1);
        }
        bar.finish_and_clear();
        let results = MpcResults {
            rows: drive.rows(),
            conditions: Conditions {
                first_seed: self.first_seed,
                episodes: seed.wrapping_sub(self.first_seed) + 1,
                steps: config.mpc.steps,
                load: Machine::here()?.load,
            },
        };
        print(&results);
        write_json_option(&self.json, &results)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Duration of a condition, ticks.
const CONDITION_TICKS: u64 = 50;
/// Ticks of random commands within the condition.
const RANDOM_TICKS: u64 = 5;
/// Range of the distance to a wall when it appears, m.
const WALL_M: (f64, f64) = (3.0, 30.0);
/// Half the width of a wall, m: more than the road's.
const WALL_SIDE_M: f64 = 15.0;

/// The condition that the car drives under for a while.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Condition {
    /// No disturbance.
    Free,
    /// A wall across the road.
    Blocked,
    /// Random commands for some ticks.
    Random,
}

impl Condition {
    const ALL: [Condition; 3] = [Condition::Free, Condition::Blocked, Condition::Random];

    fn words(self) -> &'static str {
        match self {
            Condition::Free => "free",
            Condition::Blocked => "road blocked by a wall",
            Condition::Random => "random commands",
        }
    }
}

/// Measurements under one condition.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The condition.
    pub condition: &'static str,
    /// Plans made.
    pub ticks: u64,
    /// Processor time of a whole plan, us: tracking, path, speed and solver.
    pub plan_cpu_p50_us: u64,
    /// 99 % quantile, us.
    pub plan_cpu_p99_us: u64,
    /// Maximum, us.
    pub plan_cpu_max_us: u64,
    /// Wall-clock time of a whole plan, including preemption, us.
    pub plan_p50_us: u64,
    /// 99 % quantile, us.
    pub plan_p99_us: u64,
    /// Maximum, us.
    pub plan_max_us: u64,
    /// Maximum number of solver iterations.
    pub iterations_max: u32,
    /// Problems without a solution.
    pub infeasible: u64,
    /// Plans that took longer than a period.
    pub missed: u64,
}

/// All measurements.
#[derive(Clone, Debug, Serialize)]
pub struct MpcResults {
    /// One row per condition, and one for all.
    pub rows: Vec<Row>,
    /// Conditions of the measurement.
    pub conditions: Conditions,
}

/// Conditions of the measurement.
#[derive(Clone, Debug, Serialize)]
pub struct Conditions {
    /// Seed of the first episode.
    pub first_seed: u64,
    /// Episodes begun.
    pub episodes: u64,
    /// Steps of the horizon.
    pub steps: u32,
    /// Load average of the last minute, at the end.
    pub load: Option<f64>,
}

struct Tally {
    plan_cpu_us: Histogram<u64>,
    plan_us: Histogram<u64>,
    iterations_max: u32,
    infeasible: u64,
    missed: u64,
}

struct DisturbedDrive {
    planner: Mpc,
    plan: Plan,
    dice: Xoshiro256PlusPlus,
    /// The wall's frame; the wall extends along its y axis.
    wall_world: Option<Pose>,
    tallies: [Tally; 3],
    gauges: Gauges,
    period_ns: u64,
}

impl DisturbedDrive {
    fn begin(&mut self, condition: Condition, world_from_ego: Pose) {
        let ahead_m = self.between(WALL_M.0, WALL_M.1);
        self.wall_world =
            (condition == Condition::Blocked).then(|| world_from_ego * pose(ahead_m, 0.0, 0.0));
    }

    /// Measures one plan; returns the action to drive.
    fn tick(
        &mut self,
        condition: Condition,
        condition_tick: u64,
        world: &World,
        observation: &mut Observation,
    ) -> Action {
        if let Some(wall_world) = self.wall_world {
            put_wall(
                observation,
                &(world.world_from_ego().inverse() * wall_world),
            );
        }
        let (core, begun) = (self.gauges.core(), self.gauges.now());
        self.planner.plan(observation, &mut self.plan);
        let plan_ns = self.gauges.now().since_ns(begun);
        let core = self.gauges.core() - core;
        let effort = self.planner.effort();
        let tally = &mut self.tallies[condition as usize];
        tally.plan_cpu_us.saturating_record(core.as_micros() as u64);
        tally.plan_us.saturating_record(plan_ns.div_ceil(1000));
        tally.iterations_max = tally.iterations_max.max(effort.iterations);
        tally.infeasible += u64::from(!effort.is_solved);
        tally.missed += u64::from(plan_ns > self.period_ns);
        match condition == Condition::Random && condition_tick < RANDOM_TICKS {
            true => Action {
                steer: self.between(-1.0, 1.0),
                pedal: self.between(-1.0, 1.0),
            },
            false => self.plan.action_at(0).unwrap_or(Action::BRAKE),
        }
    }

    fn rows(&self) -> Vec<Row> {
        let mut all = Tally::new();
        for tally in &self.tallies {
            all.add(tally);
        }
        let rows = Condition::ALL
            .into_iter()
            .map(Condition::words)
            .zip(&self.tallies);
        rows.chain([("all", &all)])
            .map(|(condition, tally)| tally.row(condition))
            .collect()
    }

    fn below(&mut self, count: u64) -> u64 {
        self.dice.next_u64() % count
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        let unit = (self.dice.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        low + unit * (high - low)
    }
}

/// Shortens the lidar beams that hit a wall.
fn put_wall(observation: &mut Observation, body_from_wall: &Pose) {
    let (count, fan) = (observation.beam_count as usize, observation.fan());
    let wall_from_body = body_from_wall.inverse();
    let from = wall_from_body * fan.mount_body;
    for (beam, range_m) in observation.ranges_m[..count].iter_mut().enumerate() {
        let along = wall_from_body.rotation * fan.direction_body(beam);
        let to_wall_m = -from.x / along.x;
        let side_m = from.y + along.y * to_wall_m;
        if to_wall_m > 0.0 && side_m.abs() < WALL_SIDE_M {
            *range_m = range_m.min(to_wall_m as f32);
        }
    }
}

impl Tally {
    fn new() -> Self {
        Self {
            plan_cpu_us: planning_histogram(),
            plan_us: planning_histogram(),
            iterations_max: 0,
            infeasible: 0,
            missed: 0,
        }
    }

    fn add(&mut self, other: &Tally) {
        for (mine, theirs) in [
            (&mut self.plan_cpu_us, &other.plan_cpu_us),
            (&mut self.plan_us, &other.plan_us),
        ] {
            // The histograms have equal bounds, so that adding them cannot fail.
            let _ = mine.add(theirs);
        }
        self.iterations_max = self.iterations_max.max(other.iterations_max);
        self.infeasible += other.infeasible;
        self.missed += other.missed;
    }

    fn row(&self, condition: &'static str) -> Row {
        Row {
            condition,
            ticks: self.plan_us.len(),
            plan_cpu_p50_us: self.plan_cpu_us.value_at_quantile(0.5),
            plan_cpu_p99_us: self.plan_cpu_us.value_at_quantile(0.99),
            plan_cpu_max_us: self.plan_cpu_us.max(),
            plan_p50_us: self.plan_us.value_at_quantile(0.5),
            plan_p99_us: self.plan_us.value_at_quantile(0.99),
            plan_max_us: self.plan_us.max(),
            iterations_max: self.iterations_max,
            infeasible: self.infeasible,
            missed: self.missed,
        }
    }
}

fn print(results: &MpcResults) {
    let mut table = table(&[
        "",
        "ticks",
        "core p50",
        "p99",
        "max us",
        "wall p50",
        "p99",
        "max us",
        "iterations",
        "infeasible",
        "missed",
    ]);
    for row in &results.rows {
        let numbers = [
            row.ticks,
            row.plan_cpu_p50_us,
            row.plan_cpu_p99_us,
            row.plan_cpu_max_us,
            row.plan_p50_us,
            row.plan_p99_us,
            row.plan_max_us,
            u64::from(row.iterations_max),
            row.infeasible,
            row.missed,
        ];
        let cells = numbers.map(|number| number.to_string());
        table.add_row([row.condition.to_string()].into_iter().chain(cells));
    }
    say(table);
    let conditions = &results.conditions;
    say(format_args!(
        "{}, one thread, {} from seed {}, load {}; times are of whole plans: \
         \"core\" by processor time, \"wall\" by the clock",
        counted(conditions.steps, "step"),
        counted(conditions.episodes, "episode"),
        conditions.first_seed,
        conditions
            .load
            .map_or("unknown".into(), |load| format!("{load:.1}")),
    ));
}
