//! Generates maps and scenarios over ranges of seeds and prints how long each takes and
//! its figures:
//! ```text
//! cargo run --release -p sim --example map_stats
//! cargo run --release -p sim --example map_stats -- SCrRXTO 0 500
//! ```
//!
//! Arguments: number of random blocks or a sequence of letters, first seed,
//! number of seeds.

#![expect(
    clippy::disallowed_methods,
    reason = "measuring time is what this entry point is for"
)]

use std::process::ExitCode;
use std::time::{Duration, Instant};

use sim::map::{BlockPlan, Map, MapError};
use sim::spawn::{Scenario, ScenarioConfig};

/// The ranges of seeds that are used when none is given.
const RANGES: [(u64, u64); 3] = [(0, 2000), (1000, 50), (100_000, 2000)];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &[String]) -> Result<(), String> {
    let mut config = ScenarioConfig::default();
    if let Some(plan) = arguments.first() {
        config.map.blocks = read_plan(plan).map_err(|error| error.to_string())?;
    }
    let number = |index: usize, default: u64| match arguments.get(index) {
        Some(text) => text
            .parse()
            .map_err(|_| format!("{text:?} is not a whole number")),
        None => Ok(default),
    };
    println!("{}", Row::HEADER);
    if arguments.len() > 1 {
        let range = (number(1, 0)?, number(2, 1000)?);
        return report(&config, range);
    }
    RANGES.iter().try_for_each(|&range| report(&config, range))
}

fn read_plan(text: &str) -> Result<BlockPlan, MapError> {
    match text.parse() {
        Ok(count) => Ok(BlockPlan::Random(count)),
        Err(_) => BlockPlan::parse(text),
    }
}

fn report(config: &ScenarioConfig, (first, count): (u64, u64)) -> Result<(), String> {
    let mut row = Row::default();
    for seed in first..first + count {
        row.add(config, seed).map_err(|error| error.to_string())?;
    }
    row.print(first, count);
    Ok(())
}

#[derive(Default)]
struct Row {
    map: Vec<Duration>,
    scenario: Vec<Duration>,
    lanes: usize,
    resampled: usize,
    cars: usize,
    obstacles: usize,
    route_m: f64,
}

impl Row {
    const HEADER: &str = "        seeds |   map us: mean  p99  worst | scenario us: mean  p99  worst | \
        lanes  resampled  cars  obstacles  route m";

    fn add(
        &mut self,
        config: &ScenarioConfig,
        seed: u64,
    ) -> Result<(), Box<dyn std::error::Error>> {
        self.map.push(time(|| Map::generate(&config.map, seed))?);
        let start = Instant::now();
        let scenario = Scenario::generate(config, seed)?;
        self.scenario.push(start.elapsed());
        self.lanes += scenario.map.network.lanes().len();
        self.resampled += scenario.map.blocks.iter().filter(|b| b.trials > 1).count();
        self.cars += scenario.traffic.iter().map(|g| g.cars.len()).sum::<usize>();
        self.obstacles += scenario.obstacles.len();
        self.route_m += scenario.ego.route.length_m(&scenario.map.network);
        Ok(())
    }

    fn print(mut self, first: u64, count: u64) {
        let n = count as f64;
        let [map, scenario] = [&mut self.map, &mut self.scenario].map(|times| {
            times.sort_unstable();
            let us = |time: Duration| time.as_secs_f64() * 1e6;
            let mean = times.iter().copied().map(us).sum::<f64>() / n;
            let last = times.len() - 1;
            format!(
                "{mean:5.0} {:5.0} {:6.0}",
                us(times[last * 99 / 100]),
                us(times[last])
            )
        });
        println!(
            "{first:>7}+{count:<5} |       {map} |            {scenario} | {:5.1} {:10} {:5.2} {:10.2} {:8.1}",
            self.lanes as f64 / n,
            self.resampled,
            self.cars as f64 / n,
            self.obstacles as f64 / n,
            self.route_m / n,
        );
    }
}

fn time(generate: impl FnOnce() -> Result<Map, MapError>) -> Result<Duration, MapError> {
    let start = Instant::now();
    std::hint::black_box(generate()?);
    Ok(start.elapsed())
}
