//! A simulated car that knows its motion and place only from noisy, delayed and dropped
//! sensors, in a corridor with a known map. Its speed, turning rate, pose, course and scan
//! come from `robot::estimate`; whether it touches a wall and arrives is judged by the truth.
//!
//! | variable | default | is |
//! |---|---|---|
//! | `VLAPS_EGO` | `map` | `truth`; or an estimate with scans on the `map`, from scan to scan (`scans`), or without them (`wheels`) |
//! | `VLAPS_NOISE` | 1 | multiplies the noise of all sensors, which `sensors.rs` gives |
//! | `VLAPS_DELAY_MS` | 0 | mean time from a measurement to its arrival, ms |
//! | `VLAPS_DROP` | 0 | share of the measurements that never arrive |
//!
//! cargo build --release -p robot --example estimated
//! VLAPS_DELAY_MS=100 ./vlaps up --world ./target/release/examples/estimated --lockstep --episodes 1

#[path = "estimated/car.rs"]
mod car;
#[path = "estimated/course.rs"]
mod course;
#[path = "estimated/dice.rs"]
mod dice;
#[path = "estimated/estimator.rs"]
mod estimator;
#[path = "estimated/options.rs"]
mod options;
#[path = "estimated/sensors.rs"]
mod sensors;
#[path = "estimated/walls.rs"]
mod walls;

use std::process::ExitCode;

fn main() -> ExitCode {
    robot::drive(|config| {
        let options = options::Options::read(|name| std::env::var(name).ok())?;
        car::Car::new(config, options)
    })
}
