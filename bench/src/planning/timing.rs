//! Times every planner on every scene, several times.

use anyhow::Context;
use comfy_table::Table;
use hdrhistogram::Histogram;
use planner::{Grid, Planner};
use serde::Serialize;
use shm_config::config::planner::Method;
use shm_config::config::{Config, Planner as PlannerConfig};
use shm_config::message::{Plan, PlanOutcome};

use crate::gauges::Gauges;
use lab::report;
use lab::statistics::quantile;
use stack::driver::DriverKind;
use stack::scene::Scene;

/// All methods, the paper's first.
const METHODS: [Method; 4] = [
    Method::RrtStar,
    Method::Informed,
    Method::Kinodynamic,
    Method::Mpc,
];
/// Longest time in the histogram, ns: ten seconds.
const LONGEST_NS: u64 = 10_000_000_000;

/// Results of one planner.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Name as in `--driver`.
    pub planner: &'static str,
    /// Time to build the occupancy grid.
    #[serde(flatten, serialize_with = "grid_keys")]
    pub grid: Times,
    /// Time of the whole plan without the grid: goal, search and path.
    #[serde(flatten, serialize_with = "search_keys")]
    pub search: Times,
    /// Time from observation to plan.
    #[serde(flatten, serialize_with = "plan_keys")]
    pub plan: Times,
    /// Processor time from observation to plan: excludes preemption by other work of the
    /// machine.
    #[serde(flatten, serialize_with = "core_keys")]
    pub core: Times,
    /// Path cost, m, median over the scenes whose goal is reached; `None` without such a
    /// scene.
    pub cost_median_m: Option<f64>,
    /// Share of scenes whose goal is reached.
    pub reached: f64,
    /// Share of scenes with a path that ends before the goal.
    pub partial: f64,
}

/// Quantiles of a time, us.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// Median.
    pub p50_us: f64,
    /// 99 % quantile.
    pub p99_us: f64,
    /// 99.9 % quantile.
    pub p999_us: f64,
    /// Maximum.
    pub max_us: f64,
}

/// Serialises the quantiles of one phase under the given keys.
macro_rules! keys {
    ($function:ident, $p50:literal, $p99:literal, $p999:literal, $max:literal) => {
        fn $function<S: serde::Serializer>(
            times: &Times,
            serializer: S,
        ) -> Result<S::Ok, S::Error> {
            use serde::ser::SerializeMap;
            let mut map = serializer.serialize_map(Some(4))?;
            map.serialize_entry($p50, &times.p50_us)?;
            map.serialize_entry($p99, &times.p99_us)?;
            map.serialize_entry($p999, &times.p999_us)?;
            map.serialize_entry($max, &times.max_us)?;
            map.end()
        }
    };
}
keys!(
    grid_keys,
    "grid_p50_us",
    "grid_p99_us",
    "grid_p999_us",
    "grid_max_us"
);
keys!(
    search_keys,
    "search_p50_us",
    "search_p99_us",
    "search_p999_us",
    "search_max_us"
);
keys!(
    plan_keys,
    "plan_p50_us",
    "plan_p99_us",
    "plan_p999_us",
    "plan_max_us"
);
keys!(
    core_keys,
    "plan_core_p50_us",
    "plan_core_p99_us",
    "plan_core_p999_us",
    "plan_core_max_us"
);

impl Times {
    fn of(histogram: &Histogram<u64>) -> Times {
        let us = |ns: u64| ns as f64 * 1e-3;
        Times {
            p50_us: us(histogram.value_at_quantile(0.5)),
            p99_us: us(histogram.value_at_quantile(0.99)),
            p999_us: us(histogram.value_at_quantile(0.999)),
            max_us: us(histogram.max()),
        }
    }

    fn cell(&self) -> String {
        let Times {
            p50_us,
            p99_us,
            p999_us,
            max_us,
        } = self;
        format!("{p50_us:.0} / {p99_us:.0} / {p999_us:.0} / {max_us:.0}")
    }
}

/// One planner with its measurements so far.
struct TimedPlanner {
    method: Method,
    planner: Planner,
    plan: Box<Plan>,
    grid: Grid,
    grid_ns: Histogram<u64>,
    search_ns: Histogram<u64>,
    plan_ns: Histogram<u64>,
    core_ns: Histogram<u64>,
    /// Outcome and path cost, m, for each scene.
    found: Vec<(PlanOutcome, f64)>,
}

/// The configuration for one method: that of the run, except that RRT* always uses the
/// paper's parameters.
fn configuration(method: Method, config: &Config) -> Config {
    let mut config = DriverKind::of_method(method).configure(config);
    if method == Method::RrtStar {
        config.planner = PlannerConfig {
            method,
            ..PlannerConfig::default()
        };
    }
    config
}

/// Number of plans that [`measure`] times.
pub(super) fn turns(scenes: &[Scene], rounds: u32) -> u64 {
    METHODS.len() as u64 * scenes.len() as u64 * u64::from(rounds)
}

/// Times every method. The methods alternate in each round, so that other work of the
/// machine affects all of them alike.
pub(super) fn measure(
    scenes: &[Scene],
    config: &Config,
    rounds: u32,
    gauges: Gauges,
    mut done: impl FnMut(u64),
) -> anyhow::Result<Vec<Row>> {
    let mut planners = Vec::new();
    for method in METHODS {
        planners.push(TimedPlanner::new(method, config)?);
    }
    for round in 0..rounds {
        for planner in &mut planners {
            for scene in scenes {
                planner.run(scene, gauges);
                if round == 0 {
                    let plan = &planner.plan;
                    planner.found.push((plan.outcome(), plan.cost_m));
                }
            }
            done(scenes.len() as u64);
        }
    }
    Ok(planners.iter().map(TimedPlanner::row).collect())
}

impl TimedPlanner {
    fn new(method: Method, config: &Config) -> anyhow::Result<TimedPlanner> {
        let config = configuration(method, config);
        // These constant bounds are valid.
        let histogram = || Histogram::new_with_bounds(1, LONGEST_NS, 3).context("a histogram");
        Ok(TimedPlanner {
            method,
            planner: Planner::new(&config)?,
            plan: Box::default(),
            grid: Grid::new(&config.planner),
            grid_ns: histogram()?,
            search_ns: histogram()?,
            plan_ns: histogram()?,
            core_ns: histogram()?,
            found: Vec::new(),
        })
    }

    /// Plans for one scene. The plan comes before the grid is timed, so that the cache is
    /// cold for the plan.
    fn run(&mut self, scene: &Scene, gauges: Gauges) {
        scene.prepare(&mut self.planner, &mut self.plan);
        let core_begun = gauges.core();
        let begun = gauges.now();
        self.planner.plan(&scene.observation, &mut self.plan);
        let planned = gauges.now();
        let core = gauges.core() - core_begun;
        self.grid.fill(&scene.observation);
        let filled = gauges.now();
        let (plan_ns, grid_ns) = (planned.since_ns(begun), filled.since_ns(planned));
        self.plan_ns.saturating_record(plan_ns);
        self.core_ns.saturating_record(core.as_nanos() as u64);
        self.grid_ns.saturating_record(grid_ns);
        self.search_ns
            .saturating_record(plan_ns.saturating_sub(grid_ns));
    }

    fn row(&self) -> Row {
        let share = |wanted: PlanOutcome| {
            let hits = self.found.iter().filter(|(found, _)| *found == wanted);
            hits.count() as f64 / self.found.len() as f64
        };
        let reached = self
            .found
            .iter()
            .filter(|(found, _)| *found == PlanOutcome::Reached);
        let costs: Vec<f64> = reached.map(|&(_, cost_m)| cost_m).collect();
        let cost_median_m = quantile(&costs, 0.5);
        Row {
            planner: DriverKind::of_method(self.method).word(),
            grid: Times::of(&self.grid_ns),
            search: Times::of(&self.search_ns),
            plan: Times::of(&self.plan_ns),
            core: Times::of(&self.core_ns),
            cost_median_m: cost_median_m.is_finite().then_some(cost_median_m),
            reached: share(PlanOutcome::Reached),
            partial: share(PlanOutcome::Partial),
        }
    }
}

/// The table of all planners.
pub(super) fn table(rows: &[Row]) -> Table {
    let mut table = report::table(&[
        "",
        "grid build, us",
        "search, us",
        "whole plan, us",
        "its core time, us",
        "cost median, m",
        "reached",
    ]);
    for row in rows {
        table.add_row([
            row.planner.into(),
            row.grid.cell(),
            row.search.cell(),
            row.plan.cell(),
            row.core.cell(),
            row.cost_median_m
                .map_or("-".into(), |cost_m| format!("{cost_m:.2}")),
            format!("{:.1} %", row.reached * 100.0),
        ]);
    }
    table
}
