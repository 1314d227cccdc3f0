use shm_config::message::{Header, Observation, Plan, PlanOutcome, WAYPOINTS_MAX, Waypoint};
use shm_config::settings::OutOfRange;
use vehicle::{Footprint, Point};

use crate::PlannerConfig;
use crate::goal::choose_goal;
use crate::grid::Grid;
#[cfg(feature = "std")]
use crate::memory::own_words;
use crate::memory::{GridWords, Place};
use crate::sampler::Sampler;
use crate::search::Search;
use crate::tree::Tree;

/// The paper's planner (Sec. 4.1.1): grid, goal, RRT*, path. All memory is taken
/// at the start; a plan depends on the configuration and the observation alone.
#[derive(Debug)]
pub struct RrtStar {
    config: PlannerConfig,
    grid: Grid,
    search: Place<Search>,
}

impl RrtStar {
    /// The only place that allocates.
    ///
    /// # Errors
    /// The first number of the configuration that is outside its limits.
    #[cfg(feature = "std")]
    pub fn new(config: PlannerConfig) -> Result<Self, OutOfRange> {
        Self::within(config, Box::new(Search::empty()), own_words(&config))
    }

    /// In this memory; it does not allocate.
    ///
    /// # Errors
    /// The first number of the configuration that is outside its limits.
    pub fn within(
        config: PlannerConfig,
        search: Place<Search>,
        words: Place<GridWords>,
    ) -> Result<Self, OutOfRange> {
        config.check()?;
        Ok(Self {
            config,
            grid: Grid::within(&config, words),
            search,
        })
    }

    /// For a car of this rectangle, in place of the default one's.
    pub fn for_car(mut self, footprint: Footprint) -> Self {
        self.grid = self.grid.of(footprint);
        self
    }

    /// The configuration it was made with.
    pub fn config(&self) -> &PlannerConfig {
        &self.config
    }

    /// The grid of the last plan.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// The tree of the last plan; empty before the first.
    pub fn tree(&self) -> &Tree {
        &self.search.tree
    }

    /// Plans for one admitted observation: grid, goal, tree, path (Sec. 4.1.1).
    ///
    /// Writes all of `out` except the producer and sequence number of its header
    /// and the planning time, which are the caller's. Nothing of an earlier plan
    /// is left. The work is bounded by the configuration; it does not allocate.
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
        let Self {
            config,
            grid,
            search,
        } = self;
        grid.fill(observation);
        let goal_body = choose_goal(grid, config, observation);
        let sampler = Sampler::new(config.seed, &observation.header);
        #[cfg(feature = "std")]
        grid.level(goal_body.x);
        prepared();
        search.grow(grid, config, goal_body, sampler);
        *out = Plan {
            goal_x_body_m: goal_body.x,
            goal_y_body_m: goal_body.y,
            iterations: config.iterations,
            nodes: search.tree.len() as u32,
            ..header(observation, out)
        };
        write_outcome(config, search, goal_body, out);
    }
}

/// An empty plan for an observation; the caller's fields keep their values.
pub(crate) fn header(observation: &Observation, out: &Plan) -> Plan {
    Plan {
        header: Header {
            sequence: out.header.sequence,
            producer: out.header.producer,
            ..observation.header
        },
        origin_x_world_m: observation.ego.x_world_m,
        origin_y_world_m: observation.ego.y_world_m,
        origin_heading_world_rad: observation.ego.heading_world_rad,
        planning_ns: out.planning_ns,
        ..Plan::default()
    }
}

/// Writes what was found, and the path to it.
pub(crate) fn write_outcome(
    config: &PlannerConfig,
    search: &mut Search,
    goal_body: Point,
    out: &mut Plan,
) {
    let (outcome, end) = end(config, search, goal_body);
    out.outcome = outcome.code();
    if let Some(end) = end {
        write_path(config, &search.tree, end, out);
    }
}

/// What was found, and the node where the path ends.
fn end(
    config: &PlannerConfig,
    search: &mut Search,
    goal_body: Point,
) -> (PlanOutcome, Option<usize>) {
    if let Some(end) = search.reached(goal_body, config.goal_radius_m) {
        return (PlanOutcome::Reached, Some(end));
    }
    let (end, _) = search.tree.nearest(goal_body);
    if end != 0 && search.tree.point(end).coords.norm() >= config.partial_min_m {
        return (PlanOutcome::Partial, Some(end));
    }
    (PlanOutcome::Blocked, None)
}

/// The path from the start to a node; of a longer one the first points.
fn write_path(config: &PlannerConfig, tree: &Tree, end: usize, out: &mut Plan) {
    let length = tree.way_back(end).count();
    for (before_end, index) in tree.way_back(end).enumerate() {
        let point_body = tree.point(index);
        if let Some(waypoint) = out.waypoints.get_mut(length - 1 - before_end) {
            *waypoint = Waypoint {
                x_body_m: point_body.x,
                y_body_m: point_body.y,
                speed_mps: config.speed_mps,
            };
        }
    }
    out.waypoint_count = length.min(WAYPOINTS_MAX) as u32;
    out.cost_m = tree.cost_m(end);
}
