//! The model-predictive expert driven for long, over roads that get blocked and
//! with a hand that grabs the wheel: does it always have an answer, and in time?

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
use vehicle::{Action, Point, Pose, pose};

use lab::report::{Machine, table};
use stack::driver::planning_histogram;
use supervisor::subcommand::{say, write_json_option};

/// Drive the model-predictive expert for long, disturbed: does it answer in time?
#[derive(Debug, Args)]
#[command(
    after_help = "A third of the time the road is free, a third a wall stands across it, a \
        third random commands are obeyed in place of the plan's.\n\n\
        Examples:\n  \
        ./vlaps bench mpc --json mpc.json\n  \
        ./vlaps bench mpc --ticks 2000 --set mpc.steps=16"
)]
pub struct BenchMpc {
    /// How many ticks.
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
    /// Write the figures to this file, too.
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
        let mut world = World::new(WorldConfig::from(&config.world))?;
        let mut drive = Soaking {
            planner: Mpc::new(&config),
            plan: Plan::default(),
            dice: Xoshiro256PlusPlus::seed_from_u64(self.first_seed),
            wall_world: None,
            tallies: Spell::ALL.map(|_| Tally::new()),
            gauges,
            period_ns,
        };
        let bar = ProgressBar::new(self.ticks);
        bar.set_style(ProgressStyle::with_template(
            "{elapsed_precise} {wide_bar} {pos}/{len} ticks, {eta} left",
        )?);
        let mut observation = Box::<Observation>::default();
        let (mut spell, mut seed) = (Spell::Free, self.first_seed);
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
            if tick % SPELL_TICKS == 0 {
                spell = Spell::ALL[drive.below(Spell::ALL.len() as u64) as usize];
                drive.begin(spell, world.world_from_ego());
            }
            let action = drive.tick(spell, tick % SPELL_TICKS, &world, &mut observation);
            world.step(action);
            episode_tick += 1;
            bar.inc(1);
        }
        bar.finish_and_clear();
        let soaked = Soaked {
            rows: drive.rows(),
            conditions: Conditions {
                first_seed: self.first_seed,
                episodes: seed.wrapping_sub(self.first_seed) + 1,
                steps: config.mpc.steps,
                load: Machine::here()?.load,
            },
        };
        print(&soaked);
        write_json_option(&self.json, &soaked)?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Ticks that a condition lasts.
const SPELL_TICKS: u64 = 50;
/// Ticks of a spell in which the hand grabs the wheel.
const GRABBED_TICKS: u64 = 5;
/// How far ahead a wall is put up, m.
const WALL_M: (f64, f64) = (3.0, 30.0);
/// Half its width, m: more than the road's.
const WALL_SIDE_M: f64 = 15.0;

/// What the car has to cope with for a while.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Spell {
    /// Nothing but what the map holds.
    Free,
    /// A wall across the road.
    Blocked,
    /// Random commands now and then.
    Grabbed,
}

impl Spell {
    const ALL: [Spell; 3] = [Spell::Free, Spell::Blocked, Spell::Grabbed];

    fn words(self) -> &'static str {
        match self {
            Spell::Free => "free",
            Spell::Blocked => "road blocked by a wall",
            Spell::Grabbed => "random commands",
        }
    }
}

/// What was measured under one condition.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Under which.
    pub condition: &'static str,
    /// Plans made.
    pub ticks: u64,
    /// Processor time of a whole plan, us: tracking, path, speed and solver.
    pub plan_cpu_p50_us: u64,
    /// 99 % of the plans took no more, us.
    pub plan_cpu_p99_us: u64,
    /// The most, us.
    pub plan_cpu_max_us: u64,
    /// Whole plans by the wall clock, other processes included, us.
    pub plan_p50_us: u64,
    /// 99 % of the plans took no longer, us.
    pub plan_p99_us: u64,
    /// The longest, us.
    pub plan_max_us: u64,
    /// Most iterations of the solver.
    pub iterations_max: u32,
    /// Problems without an answer.
    pub infeasible: u64,
    /// Plans that took longer than a period.
    pub missed: u64,
}

/// All measurements of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Soaked {
    /// A row for each condition, and one for all.
    pub rows: Vec<Row>,
    /// How it was measured.
    pub conditions: Conditions,
}

/// How it was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Conditions {
    /// First seed of the episodes.
    pub first_seed: u64,
    /// Episodes begun.
    pub episodes: u64,
    /// Steps of the horizon.
    pub steps: u32,
    /// Runnable threads of the whole machine over the last minute, at the end.
    pub load: Option<f64>,
}

struct Tally {
    plan_cpu_us: Histogram<u64>,
    plan_us: Histogram<u64>,
    iterations_max: u32,
    infeasible: u64,
    missed: u64,
}

struct Soaking {
    planner: Mpc,
    plan: Plan,
    dice: Xoshiro256PlusPlus,
    /// The wall's frame: it stands along y.
    wall_world: Option<Pose>,
    tallies: [Tally; 3],
    gauges: Gauges,
    period_ns: u64,
}

impl Soaking {
    fn begin(&mut self, spell: Spell, world_from_ego: Pose) {
        let ahead_m = self.between(WALL_M.0, WALL_M.1);
        self.wall_world =
            (spell == Spell::Blocked).then(|| world_from_ego * pose(ahead_m, 0.0, 0.0));
    }

    /// One plan, measured; the action to obey.
    fn tick(
        &mut self,
        spell: Spell,
        spell_tick: u64,
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
        let tally = &mut self.tallies[spell as usize];
        tally.plan_cpu_us.saturating_record(core.as_micros() as u64);
        tally.plan_us.saturating_record(plan_ns.div_ceil(1000));
        tally.iterations_max = tally.iterations_max.max(effort.iterations);
        tally.infeasible += u64::from(!effort.is_solved);
        tally.missed += u64::from(plan_ns > self.period_ns);
        match spell == Spell::Grabbed && spell_tick < GRABBED_TICKS {
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
        let rows = Spell::ALL.into_iter().map(Spell::words).zip(&self.tallies);
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

/// Shortens the beams that meet a wall.
fn put_wall(observation: &mut Observation, body_from_wall: &Pose) {
    let count = observation.beam_count as usize;
    let wall_from_body = body_from_wall.inverse();
    let from = wall_from_body * Point::origin();
    for (beam, range_m) in observation.ranges_m[..count].iter_mut().enumerate() {
        let angle_rad = std::f64::consts::TAU * beam as f64 / count as f64;
        let (sin, cos) = angle_rad.sin_cos();
        let along = wall_from_body.rotation * vehicle::Vector::new(cos, sin);
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
            // Of one kind, so they always fit.
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

fn print(soaked: &Soaked) {
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
    for row in &soaked.rows {
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
    let conditions = &soaked.conditions;
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
