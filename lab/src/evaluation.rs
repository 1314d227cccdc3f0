//! The figures of an evaluation, by the paper's metric and by the strict one.

use comfy_table::Table;
use serde::Serialize;
use shm_config::message::{Episode, Outcome};
use sim::observe::TICK_S;

use crate::episodes::{Cause, Drives, Task};
use crate::metric::Metric;
use crate::outcomes::WorldSettings;
use crate::report::{fitted, table};
use crate::statistics::Estimate;

/// The figures of an evaluation; the JSON object of `--json`.
#[derive(Clone, Debug, Serialize)]
pub struct Evaluation {
    /// The driver.
    pub driver: &'static str,
    /// World.
    pub world: &'static str,
    /// Number of episodes.
    pub episodes: usize,
    /// Seed of the first episode.
    pub first_seed: u64,
    /// What decides the maps of the seeds, where it is `[world]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub world_settings: Option<WorldSettings>,
    /// Share of episodes that arrived, with or without contacts: the paper's metric.
    pub success: Estimate,
    /// Share of episodes that arrived without any contact.
    pub strict_success: Estimate,
    /// Share of episodes with a contact with a vehicle or an object at any tick.
    pub contact: Estimate,
    /// Share of episodes with a contact with a vehicle.
    pub contact_vehicle: Estimate,
    /// Share of episodes with a contact with an object.
    pub contact_object: Estimate,
    /// Share of episodes with a contact at the last tick: the paper's crash.
    pub crash_last_step: Estimate,
    /// Share of episodes that left the road.
    pub out_of_road: Estimate,
    /// Share of episodes that reached the maximum number of steps.
    pub max_step: Estimate,
    /// Mean share of the route that was driven.
    pub completion: Estimate,
    /// Mean number of ticks of an episode.
    pub mean_length: f64,
    /// 95 % confidence interval of the mean number of ticks.
    pub mean_length_interval: [f64; 2],
    /// Driven length over time, m/s, mean over episodes.
    pub mean_speed_mps: f64,
    /// 95 % confidence interval of the mean speed.
    pub mean_speed_mps_interval: [f64; 2],
    /// 99 % quantile of the planning time, us; `None` for drivers that do not plan.
    pub planning_p99_us: Option<u64>,
    /// Failures by the strict metric.
    pub failures: Vec<Failure>,
}

/// One failed episode.
#[derive(Clone, Debug, Serialize)]
pub struct Failure {
    /// Seed of the episode.
    pub seed: u64,
    /// Cause of the failure.
    pub cause: Cause,
    /// Driven share of the route.
    pub completion: f64,
    /// Number of ticks until the end.
    pub ticks: u64,
}

impl Evaluation {
    /// Computes the figures of episodes in a world with these settings, if they are known.
    pub fn new(task: &Task, world_settings: Option<WorldSettings>, drives: &Drives) -> Evaluation {
        let episodes = &drives.episodes;
        let share = |hit: fn(&Episode) -> bool| {
            let hits = episodes.iter().filter(|episode| hit(episode)).count();
            Estimate::of_share(hits, episodes.len())
        };
        let mean = |of: fn(&Episode) -> f64| {
            let values: Vec<f64> = episodes.iter().map(of).collect();
            Estimate::of_mean(&values)
        };
        let length = mean(|episode| episode.ticks as f64);
        let speed = mean(|episode| episode.driven_m / (episode.ticks.max(1) as f64 * TICK_S));
        let planning_us = &drives.planning_us;
        Evaluation {
            driver: task.driver.word(),
            world: task.world.word(),
            episodes: episodes.len(),
            first_seed: task.first_seed,
            world_settings,
            success: share(|episode| episode.outcome() == Outcome::Arrived),
            strict_success: share(Episode::is_strict_success),
            contact: share(|episode| episode.contacts() > 0),
            contact_vehicle: share(|episode| episode.vehicle_contacts > 0),
            contact_object: share(|episode| episode.object_contacts > 0),
            crash_last_step: share(|episode| episode.crash_last_step != 0),
            out_of_road: share(|episode| episode.outcome() == Outcome::OutOfRoad),
            max_step: share(|episode| episode.outcome() == Outcome::MaxStep),
            completion: mean(|episode| episode.completion),
            mean_length: length.mean,
            mean_length_interval: [length.low, length.high],
            mean_speed_mps: speed.mean,
            mean_speed_mps_interval: [speed.low, speed.high],
            planning_p99_us: (!planning_us.is_empty()).then(|| planning_us.value_at_quantile(0.99)),
            failures: episodes.iter().filter_map(failure).collect(),
        }
    }

    /// The table of figures.
    pub fn table(&self) -> Table {
        let mut table = table(&["", "mean", "95 %"]);
        let mut row = |name: &str, estimate, digits| {
            let [mean, interval] = cells(estimate, digits);
            table.add_row([name, &mean, &interval]);
        };
        for metric in Metric::ALL {
            row(metric.name(), self.estimate(metric), metric.digits());
            if metric == Metric::Contact {
                row("  with a vehicle", self.contact_vehicle, 3);
                row("  with an object", self.contact_object, 3);
            }
        }
        if let Some(p99_us) = self.planning_p99_us {
            table.add_row(["planning p99, us (wall clock)", &p99_us.to_string(), ""]);
        }
        table
    }

    fn estimate(&self, metric: Metric) -> Estimate {
        let of = |mean, [low, high]: [f64; 2]| Estimate { mean, low, high };
        match metric {
            Metric::Success => self.success,
            Metric::StrictSuccess => self.strict_success,
            Metric::CrashLastStep => self.crash_last_step,
            Metric::Contact => self.contact,
            Metric::OutOfRoad => self.out_of_road,
            Metric::MaxStep => self.max_step,
            Metric::Completion => self.completion,
            Metric::MeanLength => of(self.mean_length, self.mean_length_interval),
            Metric::MeanSpeed => of(self.mean_speed_mps, self.mean_speed_mps_interval),
        }
    }

    /// The failures by cause, with their seeds; `None` without failures.
    pub fn failure_table(&self) -> Option<Table> {
        if self.failures.is_empty() {
            return None;
        }
        let mut table = fitted(comfy_table::presets::NOTHING);
        for cause in Cause::ALL {
            let failed = self.failures.iter();
            let seeds: Vec<String> = failed
                .filter(|failure| failure.cause == cause)
                .map(|failure| failure.seed.to_string())
                .collect();
            if !seeds.is_empty() {
                let name = format!("{} ({})", cause.words(), seeds.len());
                table.add_row([name, seeds.join(" ")]);
            }
        }
        Some(table)
    }
}

fn cells(Estimate { mean, low, high }: Estimate, digits: usize) -> [String; 2] {
    let interval = match low.is_finite() && high.is_finite() {
        true => format!("{low:.digits$} to {high:.digits$}"),
        false => "-".into(),
    };
    [format!("{mean:.digits$}"), interval]
}

fn failure(episode: &Episode) -> Option<Failure> {
    Some(Failure {
        seed: episode.seed,
        cause: Cause::of(episode)?,
        completion: episode.completion,
        ticks: episode.ticks,
    })
}
