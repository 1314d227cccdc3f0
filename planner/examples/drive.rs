//! What the planner's free numbers do to the driving:
//! `cargo run --release -p planner --example drive [COURSES]`.
//!
//! Drives random courses (three blocks of the paper's kinds, an obstacle in each)
//! with the paper's tracking controller on the kinematic bicycle, once for each
//! row of numbers, and prints how that went.

#[path = "../tests/course/mod.rs"]
mod course;

use course::driver::{drive, random_course};
use planner::PlannerConfig;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let courses = match std::env::args().nth(1) {
        Some(count) => count.parse()?,
        None => 60,
    };
    println!("{courses} courses a row, with obstacles; shares in %");
    println!(
        "{:>9} {:>5} {:>9} {:>7} | {:>7} {:>8} {:>7} {:>7} {:>7} {:>7} {:>6}",
        "distance",
        "sag",
        "inflation",
        "margin",
        "arrived",
        "off road",
        "contact",
        "partial",
        "blocked",
        "edge m",
        "steer"
    );
    let default = PlannerConfig::default();
    for goal_distance_m in [8.0, 12.0, 15.0, 20.0, 30.0] {
        row(
            &PlannerConfig {
                goal_distance_m,
                ..default
            },
            courses,
        );
    }
    for goal_sag_m in [0.1, 0.5, 1.0, 100.0] {
        row(
            &PlannerConfig {
                goal_sag_m,
                ..default
            },
            courses,
        );
    }
    for inflation_m in [0.8, 1.1, 1.4] {
        row(
            &PlannerConfig {
                inflation_m,
                ..default
            },
            courses,
        );
    }
    Ok(())
}

fn row(config: &PlannerConfig, courses: u64) {
    let drives: Vec<_> = (0..courses)
        .map(|seed| {
            let config = PlannerConfig { seed, ..*config };
            drive(
                &random_course(seed, true),
                config,
                3.5 * (seed % 3) as f64 - 3.5,
            )
        })
        .collect();
    let share = |count: usize| 100.0 * count as f64 / drives.len() as f64;
    let ticks = drives.iter().map(|drive| drive.ticks).sum::<u64>().max(1) as f64;
    let mean = |of: &dyn Fn(&course::driver::Drive) -> f64| {
        drives.iter().map(of).sum::<f64>() / drives.len() as f64
    };
    println!(
        "{:9} {:5} {:9} {:7} | {:7.0} {:8.0} {:7.0} {:7.1} {:7.1} {:7.2} {:6.3}",
        config.goal_distance_m,
        config.goal_sag_m,
        config.inflation_m,
        config.lane_margin_m,
        share(drives.iter().filter(|drive| drive.arrived).count()),
        share(drives.iter().filter(|drive| drive.left_road).count()),
        share(
            drives
                .iter()
                .filter(|drive| drive.clearance_m <= 0.0)
                .count()
        ),
        100.0 * drives.iter().map(|drive| drive.partial).sum::<u64>() as f64 / ticks,
        100.0 * drives.iter().map(|drive| drive.blocked).sum::<u64>() as f64 / ticks,
        mean(&|drive| drive.edge_m),
        mean(&|drive| drive.steer_mean),
    );
}
