//! The paper's planner beside OMPL's RRTstar: both plan for the same scenes on the
//! same core, alternating within one run.

use anyhow::Context;
use planner::{Grid, Planner, RrtStar};
use serde::Serialize;
use shm_config::config::{Config, Planner as PlannerConfig};
use shm_config::message::{Plan, PlanOutcome};
use shm_config::settings::planner::NODES_MAX;

use super::met;
use super::ompl::{OmplProcess, Program, Task};
use lab::report::table;
use lab::statistics::quantile;
use stack::Clock;
use stack::scene::Scene;
use supervisor::subcommand::say;

/// Iterations at which path cost and time are measured.
const BUDGETS: [u32; 6] = [50, 100, 200, 400, 800, 1600];
/// Index of the paper's iterations in [`BUDGETS`].
const PAPER: usize = 2;
/// Scenes that one planner plans for before the other does: few enough that both meet
/// the same load of the machine, many enough that the cold caches after each change
/// matter little.
const TURN: usize = 25;
/// Maximum number of rounds at equal iterations.
const ROUNDS_MAX: u32 = 5;
/// Seed of our samples in the curve; the rounds have seeds 1 to [`ROUNDS_MAX`]. Scenes
/// are recorded with the default seed 0. No comparison uses it: scenes recorded because
/// the goal was not reached would bias the result against our planner.
const CURVE_SEED: u64 = ROUNDS_MAX as u64 + 1;
/// One scene in this many is in the curve.
const CURVE_EVERY: usize = 3;
/// The project's targets: speed-up and path cost over OMPL's.
const BAR_TIMES: f64 = 5.0;
const BAR_COST: f64 = 1.01;

/// Both planners, side by side.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// OMPL's version.
    pub version: String,
    /// Iterations of each planner.
    pub iterations: u32,
    /// Plans of each planner.
    pub plans: usize,
    /// Ours, from observation to plan.
    pub ours: Side,
    /// Ours without the grid, which OMPL receives ready-made: goal, search and path.
    pub ours_search_p50_us: f64,
    /// OMPL, search only.
    pub ompl: Side,
    /// OMPL's median time over ours, whole plan.
    pub times_faster: f64,
    /// OMPL's median time over ours, search only.
    pub times_faster_search: f64,
    /// Our cost over OMPL's, median over the plans that both solve.
    pub cost_ratio_median: f64,
    /// Number of plans that both solve.
    pub both: usize,
    /// Path cost over time.
    pub curve: Vec<Point>,
    /// Time that our planner needs for OMPL's cost after [`Comparison::iterations`], us;
    /// `None` if no budget reaches that cost.
    pub ours_at_equal_cost_us: Option<f64>,
    /// OMPL's time over ours at that cost.
    pub times_faster_at_equal_cost: Option<f64>,
}

/// Results of one planner.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Side {
    /// Median time, us.
    pub p50_us: f64,
    /// 99 % quantile of the time, us.
    pub p99_us: f64,
    /// Share of plans that reach the goal.
    pub reached: f64,
    /// Path length, m, median over the plans that both solve.
    pub cost_median_m: f64,
}

/// Both planners at one number of iterations.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Point {
    /// Iterations.
    pub iterations: u32,
    /// Our median time, us, including the grid.
    pub ours_p50_us: f64,
    /// Our median cost over the scenes of the curve, m; unsolved scenes count as
    /// infinite.
    pub ours_cost_median_m: f64,
    /// OMPL's median time, us.
    pub ompl_p50_us: f64,
    /// OMPL's median cost, m.
    pub ompl_cost_median_m: f64,
}

/// One plan of our planner.
#[derive(Clone, Copy)]
struct Ours {
    plan_ns: u64,
    search_ns: u64,
    cost_m: Option<f64>,
}

/// One plan of each planner.
#[derive(Clone, Copy)]
struct Pair {
    ours: Ours,
    ompl_ns: u64,
    ompl_cost_m: Option<f64>,
}

/// Number of plan pairs that [`compare`] makes.
pub(super) fn turns(scenes: &[Scene], rounds: u32) -> u64 {
    let equal = scenes.len() as u64 * u64::from(rounds.min(ROUNDS_MAX));
    let curve = scenes.len().div_ceil(CURVE_EVERY) * BUDGETS.len();
    equal + curve as u64
}

/// Plans for all scenes with both planners.
pub(super) fn compare(
    program: &Program,
    scenes: &[Scene],
    rounds: u32,
    clock: Clock,
    mut done: impl FnMut(u64),
) -> anyhow::Result<Comparison> {
    let rounds = rounds.min(ROUNDS_MAX);
    let all: Vec<&Scene> = scenes.iter().collect();
    let mut both = SideBySide::begin(program, all, clock)?;
    let mut pairs = Vec::new();
    for round in 1..=rounds {
        pairs.extend(both.plan_all(BUDGETS[PAPER], round.into(), &mut done)?);
    }
    let some: Vec<&Scene> = scenes.iter().step_by(CURVE_EVERY).collect();
    let mut both = SideBySide::begin(program, some, clock)?;
    let mut budgets = Vec::new();
    for iterations in BUDGETS {
        budgets.push(both.plan_all(iterations, CURVE_SEED, &mut done)?);
    }
    let curve = curve(&budgets);
    let (ours_at, times) = at_equal_cost(&curve).unzip();
    Ok(equal(&pairs, program, (curve, ours_at, times)))
}

/// Both planners with some scenes loaded.
struct SideBySide<'a> {
    scenes: Vec<&'a Scene>,
    ompl: OmplProcess,
    clock: Clock,
    grid: Grid,
}

impl<'a> SideBySide<'a> {
    fn begin(
        program: &Program,
        scenes: Vec<&'a Scene>,
        clock: Clock,
    ) -> anyhow::Result<SideBySide<'a>> {
        let config = PlannerConfig::default();
        let mut planner = RrtStar::new(config)?;
        let mut plan = Box::<Plan>::default();
        let tasks: Vec<Task> = scenes
            .iter()
            .map(|scene| {
                planner.plan(&scene.observation, &mut plan);
                Task::new(planner.grid(), &plan)
            })
            .collect();
        let grid = Grid::new(&config);
        Ok(SideBySide {
            ompl: program.start(&tasks, &grid, &config)?,
            scenes,
            clock,
            grid,
        })
    }

    /// Both plan once for every scene, alternating.
    fn plan_all(
        &mut self,
        iterations: u32,
        seed: u64,
        done: &mut impl FnMut(u64),
    ) -> anyhow::Result<Vec<Pair>> {
        let config = PlannerConfig {
            iterations,
            seed,
            // OMPL's radius shrinks with other constants; here both keep 3 m.
            shrink_after: NODES_MAX as u32,
            ..PlannerConfig::default()
        };
        let mut planner = Planner::new(&Config {
            planner: config,
            ..Config::default()
        })?;
        let mut pairs = Vec::new();
        for begin in (0..self.scenes.len()).step_by(TURN) {
            let turn = begin..self.scenes.len().min(begin + TURN);
            let ours: Vec<Ours> = turn
                .clone()
                .map(|scene| self.plan(&mut planner, scene))
                .collect();
            let answers = self.ompl.plan(turn.clone(), iterations);
            let answers = answers.with_context(|| format!("{iterations} iterations"))?;
            pairs.extend(ours.into_iter().zip(answers).map(|(ours, answer)| Pair {
                ours,
                ompl_ns: answer.time_ns,
                ompl_cost_m: answer.cost_m,
            }));
            done(turn.len() as u64);
        }
        Ok(pairs)
    }

    fn plan(&mut self, planner: &mut Planner, scene: usize) -> Ours {
        let observation = &self.scenes[scene].observation;
        let mut plan = Plan::default();
        let begun = (self.clock)();
        planner.plan(observation, &mut plan);
        let planned = (self.clock)();
        self.grid.fill(observation);
        let grid_ns = (self.clock)().since_ns(planned);
        let plan_ns = planned.since_ns(begun);
        Ours {
            plan_ns,
            search_ns: plan_ns.saturating_sub(grid_ns),
            cost_m: (plan.outcome() == PlanOutcome::Reached).then_some(plan.cost_m),
        }
    }
}

/// A quantile of times, us.
fn time_us(pairs: &[Pair], share: f64, of: fn(&Pair) -> u64) -> f64 {
    let times: Vec<f64> = pairs.iter().map(|pair| of(pair) as f64 * 1e-3).collect();
    quantile(&times, share)
}

/// The comparison at equal iterations, together with the curve.
fn equal(
    pairs: &[Pair],
    program: &Program,
    (curve, ours_at_equal_cost_us, times_faster_at_equal_cost): (
        Vec<Point>,
        Option<f64>,
        Option<f64>,
    ),
) -> Comparison {
    let both: Vec<(f64, f64)> = pairs
        .iter()
        .filter_map(|pair| Some((pair.ours.cost_m?, pair.ompl_cost_m?)))
        .collect();
    let median =
        |of: fn(&(f64, f64)) -> f64| quantile(&both.iter().map(of).collect::<Vec<f64>>(), 0.5);
    let side = |time: fn(&Pair) -> u64, cost: fn(&Pair) -> Option<f64>, cost_median_m| Side {
        p50_us: time_us(pairs, 0.5, time),
        p99_us: time_us(pairs, 0.99, time),
        reached: pairs.iter().filter_map(cost).count() as f64 / pairs.len() as f64,
        cost_median_m,
    };
    let ours = side(
        |pair| pair.ours.plan_ns,
        |pair| pair.ours.cost_m,
        median(|both| both.0),
    );
    let ompl = side(
        |pair| pair.ompl_ns,
        |pair| pair.ompl_cost_m,
        median(|both| both.1),
    );
    let ours_search_p50_us = time_us(pairs, 0.5, |pair| pair.ours.search_ns);
    Comparison {
        version: program.version.clone(),
        iterations: BUDGETS[PAPER],
        plans: pairs.len(),
        ours,
        ours_search_p50_us,
        ompl,
        times_faster: ompl.p50_us / ours.p50_us,
        times_faster_search: ompl.p50_us / ours_search_p50_us,
        cost_ratio_median: median(|both| both.0 / both.1),
        both: both.len(),
        curve,
        ours_at_equal_cost_us,
        times_faster_at_equal_cost,
    }
}

/// Path cost over time, for the scenes that both solve with the paper's iterations.
fn curve(budgets: &[Vec<Pair>]) -> Vec<Point> {
    let is_of_it: Vec<bool> = budgets[PAPER]
        .iter()
        .map(|pair| pair.ours.cost_m.is_some() && pair.ompl_cost_m.is_some())
        .collect();
    let point = |(pairs, iterations): (&Vec<Pair>, u32)| {
        let pairs: Vec<Pair> = pairs
            .iter()
            .zip(&is_of_it)
            .filter_map(|(pair, is_of_it)| is_of_it.then_some(*pair))
            .collect();
        let cost = |of: fn(&Pair) -> Option<f64>| {
            let costs = pairs.iter().map(|pair| of(pair).unwrap_or(f64::INFINITY));
            quantile(&costs.collect::<Vec<f64>>(), 0.5)
        };
        Point {
            iterations,
            ours_p50_us: time_us(&pairs, 0.5, |pair| pair.ours.plan_ns),
            ours_cost_median_m: cost(|pair| pair.ours.cost_m),
            ompl_p50_us: time_us(&pairs, 0.5, |pair| pair.ompl_ns),
            ompl_cost_median_m: cost(|pair| pair.ompl_cost_m),
        }
    };
    budgets.iter().zip(BUDGETS).map(point).collect()
}

/// Our time, us, for the cost that OMPL reaches with the paper's iterations, and OMPL's
/// time over it. Between two budgets, the logarithm of the time is linear in the
/// cost. If the smallest budget is good enough, its time.
fn at_equal_cost(curve: &[Point]) -> Option<(f64, f64)> {
    let ompl = curve.get(PAPER)?;
    let wanted_m = ompl.ompl_cost_median_m;
    let first = curve.first()?;
    let ours_us = if first.ours_cost_median_m <= wanted_m {
        first.ours_p50_us
    } else {
        let [worse, better] = curve
            .array_windows()
            .find(|[_, better]| better.ours_cost_median_m <= wanted_m)?;
        let span_m = worse.ours_cost_median_m - better.ours_cost_median_m;
        let share = match span_m.is_finite() {
            true => (worse.ours_cost_median_m - wanted_m) / span_m,
            // A budget without a finite cost cannot be interpolated.
            false => 1.0,
        };
        worse.ours_p50_us * (better.ours_p50_us / worse.ours_p50_us).powf(share)
    };
    Some((ours_us, ompl.ompl_p50_us / ours_us))
}

impl Comparison {
    /// Prints the tables and the targets.
    pub fn print(&self) {
        let Comparison {
            version,
            iterations,
            plans,
            ours,
            ompl,
            ..
        } = self;
        say(format_args!(
            "\nOMPL {version} RRTstar, {iterations} iterations each, {plans} plans each, alternating \
             on one core"
        ));
        let mut equal = table(&["", "p50, us", "p99, us", "reached", "cost median, m"]);
        let mut row = |name: &str, side: &Side| {
            equal.add_row([
                name.into(),
                format!("{:.0}", side.p50_us),
                format!("{:.0}", side.p99_us),
                format!("{:.1} %", side.reached * 100.0),
                format!("{:.3}", side.cost_median_m),
            ]);
        };
        row("VLAPS, grid and search", ours);
        row("OMPL, search alone", ompl);
        say(equal);
        let mut curve = table(&[
            "iterations",
            "VLAPS, us",
            "cost median, m",
            "OMPL, us",
            "cost median, m",
        ]);
        for point in &self.curve {
            curve.add_row([
                point.iterations.to_string(),
                format!("{:.0}", point.ours_p50_us),
                format!("{:.3}", point.ours_cost_median_m),
                format!("{:.0}", point.ompl_p50_us),
                format!("{:.3}", point.ompl_cost_median_m),
            ]);
        }
        say(curve);
        self.print_bars();
    }

    fn print_bars(&self) {
        say(format_args!(
            "equal iterations: {:.1} times faster with the grid, bar {BAR_TIMES}: {}; {:.1} times \
             in the search alone",
            self.times_faster,
            met(self.times_faster >= BAR_TIMES),
            self.times_faster_search,
        ));
        say(format_args!(
            "equal iterations: path cost {:.4} of OMPL's, median of {} plans that both find, bar \
             {BAR_COST}: {}",
            self.cost_ratio_median,
            self.both,
            met(self.cost_ratio_median <= BAR_COST)
        ));
        match (self.ours_at_equal_cost_us, self.times_faster_at_equal_cost) {
            (Some(ours_us), Some(times)) => say(format_args!(
                "equal path cost: {ours_us:.0} us for what OMPL has after {} iterations, {times:.1} \
                 times faster",
                self.iterations
            )),
            _ => say("equal path cost: not reached within the largest budget"),
        }
    }
}
