//! How long a plan takes:
//! `cargo run --release -p planner --example plan_speed [METHOD [ITERATIONS [SHRINK_AFTER]]]`.
//!
//! Plans for synthetic scenes (straight roads and bends of 15 to 60 m, up to
//! four cars, barriers or rows of cones, 240 beams) and prints the whole plan,
//! the grid within it, and the rest, in microseconds. METHOD is one of the
//! configuration's, such as kinodynamic; without it, the paper's. ITERATIONS and
//! SHRINK_AFTER are those of `planner`; without them, the configuration's.
#![allow(clippy::disallowed_methods)]

use std::hint::black_box;
use std::time::Instant;

use planner::{Grid, Planner};
use shm_config::config::Config;
use shm_config::message::{Observation, Plan, PlanOutcome};

#[path = "../tests/course/mod.rs"]
mod course;

const SCENES: u64 = 500;
const ROUNDS: usize = 20;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let method = std::env::args().nth(1).unwrap_or("rrt_star".into());
    let mut configuration = format!("planner.method = \"{method}\"\n");
    for (key, value) in ["iterations", "shrink_after"]
        .iter()
        .zip(std::env::args().skip(2))
    {
        configuration += &format!("planner.{key} = {value}\n");
    }
    let configuration: Config = shm_config::config::from_toml(&configuration, "arguments")?;
    let config = configuration.planner;
    let scenes: Vec<Observation> = (0..SCENES).map(course::random_scene).collect();
    let mut planner = Planner::new(&configuration)?;
    let mut grid = Grid::new(&config);
    let mut plan = Plan::default();
    let mut whole_us = Vec::with_capacity(scenes.len() * ROUNDS);
    let (mut grid_us, mut search_us) = (whole_us.clone(), whole_us.clone());
    let (mut outcomes, mut nodes) = ([0; 3], 0);
    let mut cost_m = 0.0;
    for scene in scenes.iter().cycle().take(scenes.len() * ROUNDS) {
        let start = Instant::now();
        grid.fill(black_box(scene));
        let filled = Instant::now();
        planner.plan(black_box(scene), &mut plan);
        let planned = Instant::now();
        let us = |from: Instant, to: Instant| (to - from).as_secs_f64() * 1e6;
        grid_us.push(us(start, filled));
        whole_us.push(us(filled, planned));
        search_us.push(us(filled, planned) - us(start, filled));
        outcomes[plan.outcome() as usize] += 1;
        nodes += u64::from(plan.nodes);
        if plan.outcome() == PlanOutcome::Reached {
            cost_m += plan.cost_m;
        }
    }
    let plans = whole_us.len();
    let of = |outcome: PlanOutcome| 100.0 * f64::from(outcomes[outcome as usize]) / plans as f64;
    println!(
        "{plans} plans of {} iterations, {:.0} nodes on average; reached {:.1} %, partial {:.1} %, blocked {:.1} %",
        config.iterations,
        nodes as f64 / plans as f64,
        of(PlanOutcome::Reached),
        of(PlanOutcome::Partial),
        of(PlanOutcome::Blocked),
    );
    let mean_m = cost_m / f64::from(outcomes[PlanOutcome::Reached as usize].max(1));
    println!("cost of those that reach: {mean_m:.3} m on average");
    println!(
        "{:20} {:>8} {:>8} {:>8} {:>8}",
        "us", "p50", "p99", "p99.9", "max"
    );
    // Each scene's fastest round is what the work costs; all rounds are what
    // the work and the rest of the machine cost.
    for (name, values) in [("plan", whole_us), ("grid", grid_us), ("rest", search_us)] {
        let fastest = (0..scenes.len())
            .map(|scene| {
                let rounds = values.iter().skip(scene).step_by(scenes.len());
                rounds.copied().fold(f64::INFINITY, f64::min)
            })
            .collect();
        row(&format!("{name}, fastest round"), fastest);
        row(&format!("{name}, all rounds"), values);
    }
    Ok(())
}

fn row(name: &str, mut values: Vec<f64>) {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
    println!(
        "{name:20} {:8.1} {:8.1} {:8.1} {:8.1}",
        at(0.5),
        at(0.99),
        at(0.999),
        at(1.0)
    );
}
