#[cfg(feature = "std")]
use shm_config::config::Config;
use shm_config::message::{Observation, Plan, PlanOutcome};
use shm_config::settings::planner::NODES_MAX;
use shm_config::settings::{Kinodynamic as Settings, OutOfRange};
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Pose, Vehicle, pose, wrap_rad};

use crate::PlannerConfig;
use crate::centre_line::CentreLine;
use crate::grid::Grid;
#[cfg(feature = "std")]
use crate::memory::own_words;
use crate::memory::{GridWords, Place};
use crate::rrt_star::header;
use crate::sampler::Sampler;

mod body;
mod goal;
mod path;
mod search;

use body::Body;
pub use path::Path;
use search::Question;
pub use search::Search;

/// Of the budget, one part in so many may pass without a way to the goal before
/// the slow car's tighter curves have the rest: a tree that reaches its goal mostly
/// does so early. A quarter reaches 84.0 % of 500 scenes' goals, halves
/// 83.0 %.
const FAST_PART: u32 = 4;

/// RRT* over the bicycle: nodes are poses, edges are the shortest curves that a
/// car with this turning circle can drive forwards.
///
/// Karaman & Frazzoli (*Optimal kinodynamic motion planning using incremental
/// sampling-based methods*, 2010; *Sampling-based optimal motion planning for
/// non-holonomic dynamical systems*, 2013) show that RRT* stays optimal in the
/// limit with a steering function that is exact and locally optimal. At constant
/// speed, the bicycle of Eq. 3 to 5 is Dubins' car, whose shortest curves are
/// known in closed form; so that is the steering function here ([`crate::Dubins`]), and
/// the cost is the length. The least radius is the car's own, `L / tan(delta_max)`,
/// or `v² / a` for the sideways acceleration allowed, whichever is more.
///
/// A plan begins where the car is and as it is turned, so the car can drive it
/// as it stands, except for the time that the wheels take to turn. It depends on the
/// configuration and the observation alone. All memory is taken at the start.
#[derive(Debug)]
pub struct Kinodynamic {
    config: PlannerConfig,
    settings: Settings,
    vehicle: Vehicle,
    body: Body,
    grid: Grid,
    search: Place<Search>,
    path: Place<Path>,
    radius_m: f64,
}

/// One node of the tree over poses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseNode {
    /// Where it is, and how it is turned.
    pub body_from_node: Pose,
    /// The node before it on the way from the start; `None` at the start itself.
    pub parent: Option<usize>,
    /// Length of the way from the start, m: the sum of the edges.
    pub cost_m: f64,
}

impl Kinodynamic {
    /// The only place that allocates.
    ///
    /// # Errors
    /// The first number of the configuration that is outside its limits; also
    /// when the grid has no room for discs as large as the body's.
    #[cfg(feature = "std")]
    pub fn new(config: &Config) -> Result<Self, OutOfRange> {
        Self::within(
            (config.planner, config.kinodynamic, config.vehicle),
            (Box::new(Search::empty()), Box::new(Path::empty())),
            own_words(&config.planner),
        )
    }

    /// For these settings and this car, in this memory; it does not allocate.
    ///
    /// # Errors
    /// The first number of the settings that is outside its limits; also when the grid
    /// has no room for discs as large as the body's.
    pub fn within(
        (planner, settings, vehicle): (PlannerConfig, Settings, Vehicle),
        (search, path): (Place<Search>, Place<Path>),
        words: Place<GridWords>,
    ) -> Result<Self, OutOfRange> {
        settings.check()?;
        let body = Body::new(&vehicle);
        let planner = PlannerConfig {
            inflation_m: body.radius_m + settings.clearance_m,
            lane_margin_m: settings.lane_margin_m,
            ..planner
        };
        planner.check()?;
        Ok(Self {
            config: planner,
            settings,
            vehicle,
            body,
            grid: Grid::within(&planner, words).of(vehicle.footprint()),
            search,
            path,
            radius_m: 0.0,
        })
    }

    /// The planner's section it was made with; its inflation is what the body
    /// and the clearance make of it, its margin its own.
    pub fn config(&self) -> &PlannerConfig {
        &self.config
    }

    /// The grid of the last plan.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// All nodes of the last plan in the order they were made, the start first.
    pub fn nodes(&self) -> impl Iterator<Item = PoseNode> + '_ {
        let poses = self.search.poses.iter();
        poses
            .zip(self.search.tree.nodes())
            .map(|(at, node)| PoseNode {
                body_from_node: *at,
                parent: node.parent,
                cost_m: node.cost_m,
            })
    }

    /// Least radius of the last plan's curves, m.
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// The points of the body, m ahead of its middle, that the grid is asked at.
    pub fn body_ahead_m(&self) -> [f64; 3] {
        self.body.ahead_m
    }

    /// The least radius of a turn at a speed, m.
    pub fn turning_radius_m(&self, speed_mps: f64) -> f64 {
        let own_m = self.vehicle.wheelbase_m / self.vehicle.max_steer_rad().tan();
        own_m.max(speed_mps * speed_mps / self.settings.lateral_mps2)
    }

    /// Plans for one admitted observation: grid along the road, goal pose, tree,
    /// path; once more with the tighter curves of a slower car when the first
    /// tree does not reach the goal early. Both trees together take a budget when
    /// neither reaches it, a quarter more at most when the second does, and
    /// nothing when one curve leads there.
    ///
    /// Writes all of `out` except the producer and sequence number of its header
    /// and the planning time, which are the caller's. Waypoints are at most 64,
    /// half a metre or more apart along the path, each with a speed that keeps
    /// the sideways acceleration, and that the next one's can be reached from by
    /// braking gently; a path that does not reach the goal ends at rest.
    pub fn plan(&mut self, observation: &Observation, out: &mut Plan) {
        self.plan_in_parts(observation, out, || ());
    }

    /// The same; `prepared` is called before the search begins.
    pub(crate) fn plan_in_parts(
        &mut self,
        observation: &Observation,
        out: &mut Plan,
        prepared: impl FnOnce(),
    ) {
        let line = CentreLine::new(observation);
        self.grid.fill_along(observation, &line, &self.body.ahead_m);
        let limits_m = (self.settings.goal_distance_m, self.settings.goal_sag_m);
        let (goal, along_m) = goal::choose_goal(&self.grid, &self.body, &line, limits_m);
        *out = Plan {
            goal_x_body_m: goal.translation.x,
            goal_y_body_m: goal.translation.y,
            ..header(observation, out)
        };
        prepared();
        let mut sampler = Sampler::new(self.config.seed, &observation.header);
        let mut end = None;
        let [fast_m, slow_m] = [self.config.speed_mps, self.settings.slow_mps]
            .map(|speed_mps| self.turning_radius_m(speed_mps));
        let budget = self.config.iterations;
        let fast_tries = match slow_m < fast_m {
            true => budget.div_ceil(FAST_PART),
            false => budget,
        };
        for (radius_m, tries) in [(fast_m, fast_tries), (slow_m, budget - fast_tries)] {
            if tries == 0 {
                break;
            }
            self.radius_m = radius_m;
            out.iterations += self.grow(&line, (goal, along_m), &mut sampler, tries);
            end = self.reached(&goal);
            if end.is_some() {
                break;
            }
        }
        out.nodes = self.search.tree.len() as u32;
        out.outcome = PlanOutcome::Reached.code();
        if end.is_none() {
            end = self.nearest(&goal);
            out.outcome = match end {
                Some(_) => PlanOutcome::Partial.code(),
                None => PlanOutcome::Blocked.code(),
            };
        }
        if let Some(end) = end {
            self.path.follow(&self.search, end, self.radius_m);
            self.path.write(&self.config, &self.settings, out);
        }
    }

    /// Grows a new tree until the budget is spent, or so many iterations have
    /// passed without a way to the goal, or none can be shorter than the one
    /// there is. Returns the iterations.
    fn grow(
        &mut self,
        line: &CentreLine,
        goal: (Pose, f64),
        sampler: &mut Sampler,
        tries: u32,
    ) -> u32 {
        let question = Question {
            body: self.body,
            radius_m: self.radius_m,
            reach_m: self.settings.reach_m,
            goal: goal.0,
        };
        self.search.restart(&self.grid, &question);
        for iteration in 0..self.config.iterations {
            if self.search.is_done() || (iteration >= tries && self.search.goal.is_none()) {
                return iteration;
            }
            let sample = self.sample(line, goal.1, sampler);
            self.search.extend(&self.grid, &question, &sample);
        }
        self.config.iterations
    }

    /// A pose on the road before the goal: uniform along it and across it; its
    /// heading within the spread around the road's, or any.
    fn sample(&self, line: &CentreLine, along_m: f64, sampler: &mut Sampler) -> Pose {
        let corridor = self.grid.corridor();
        let wild = sampler.unit() < self.settings.uniform_share;
        let road = line.at(sampler.unit() * along_m).body_from_road;
        let origin_m = line.at(0.0).body_from_road.translation.y;
        let across_m =
            corridor.right_m + sampler.unit() * (corridor.left_m - corridor.right_m) - origin_m;
        let spread_rad = match wild {
            true => core::f64::consts::PI,
            false => self.settings.spread_rad,
        };
        road * pose(0.0, across_m, spread_rad * (2.0 * sampler.unit() - 1.0))
    }

    /// The goal's own node, or of those in the goal ball that head about as the
    /// road does the cheapest.
    fn reached(&self, goal: &Pose) -> Option<usize> {
        let Search { tree, poses, .. } = &*self.search;
        let in_ball = |&index: &usize| {
            let (way, turn) = (
                poses[index].translation.vector - goal.translation.vector,
                poses[index].rotation.angle() - goal.rotation.angle(),
            );
            way.norm() <= self.config.goal_radius_m
                && wrap_rad(turn).abs() <= self.settings.goal_heading_rad
        };
        let cheapest = || {
            (1..tree.len().min(NODES_MAX))
                .filter(in_ball)
                .min_by(|&a, &b| tree.cost_m(a).total_cmp(&tree.cost_m(b)))
        };
        self.search.goal.or_else(cheapest)
    }

    /// The node nearest to the goal, if the path to it is long enough to drive.
    fn nearest(&mut self, goal: &Pose) -> Option<usize> {
        let tree = &mut self.search.tree;
        let (end, _) = tree.nearest(goal.translation.vector.into());
        let far_enough = tree.point(end).coords.norm() >= self.config.partial_min_m;
        (end != 0 && far_enough).then_some(end)
    }
}
