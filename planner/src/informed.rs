use shm_config::message::{Header, Observation, Plan, WAYPOINTS_MAX};
use shm_config::settings::{Informed as Settings, OutOfRange};
use vehicle::{Footprint, Point, Pose, pose};

use crate::PlannerConfig;
use crate::ellipse::Ellipse;
use crate::goal::choose_goal;
use crate::grid::Grid;
#[cfg(feature = "std")]
use crate::memory::own_words;
use crate::memory::{GridWords, Place};
use crate::rrt_star::{header, write_outcome};
use crate::sampler::{Region, Sampler};
use crate::search::{Search, widely};
use crate::tree::Tree;

/// The paper's planner with two additions: it begins with the rest of its last path, and
/// once it has a path to the goal, it samples only where a shorter one is possible.
///
/// *Warm start.* The last path is moved by what the ego has moved since. Of its
/// points those that are still ahead become the first nodes, from the car on,
/// as far as the edge from each to the next is free; each costs one iteration of
/// the budget. So a path that is still free is never replaced by a longer one.
///
/// *Connection.* It extends straight to the goal, a step at a time, until an obstacle
/// blocks it (the *connect* of RRT-Connect, Kuffner & LaValle 2000); each step is one
/// iteration.
///
/// *Informed sampling* (Gammell et al. 2014): with a path of the cost c into the
/// goal ball of radius r, a shorter one only passes points whose distances to
/// car and goal are less than c + r together.
///
/// The memory is one path. It is used only at the next tick of the same episode, and
/// not when it is too old. The same observations in the same order
/// give the same plans. All memory is taken at the start.
#[derive(Debug)]
pub struct Informed {
    config: PlannerConfig,
    settings: Settings,
    grid: Grid,
    search: Place<Search>,
    memory: Option<Memory>,
    warm_nodes: usize,
}

/// The last path, and when and where it was made.
#[derive(Debug, Clone)]
struct Memory {
    header: Header,
    world_from_plan: Pose,
    points_plan: heapless::Vec<Point, WAYPOINTS_MAX>,
}

impl Informed {
    /// The only place that allocates.
    ///
    /// # Errors
    /// The first number of the configuration that is outside its limits.
    #[cfg(feature = "std")]
    pub fn new(config: PlannerConfig, settings: Settings) -> Result<Self, OutOfRange> {
        let search = Box::new(Search::empty());
        Self::within(config, settings, search, own_words(&config))
    }

    /// In this memory; it does not allocate.
    ///
    /// # Errors
    /// The first number of the configuration that is outside its limits.
    pub fn within(
        config: PlannerConfig,
        settings: Settings,
        search: Place<Search>,
        words: Place<GridWords>,
    ) -> Result<Self, OutOfRange> {
        config.check()?;
        settings.check(config.cell_m)?;
        let config = PlannerConfig {
            inflation_m: settings.inflation_m,
            ..config
        };
        Ok(Self {
            config,
            settings,
            grid: Grid::within(&config, words),
            search,
            memory: None,
            warm_nodes: 0,
        })
    }

    /// For a car of this rectangle, in place of the default one's.
    pub fn for_car(mut self, footprint: Footprint) -> Self {
        self.grid = self.grid.of(footprint);
        self
    }

    /// The planner's section it was made with, with its own inflation.
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

    /// How many nodes of the last plan's tree were those of the plan before.
    pub fn warm_nodes(&self) -> usize {
        self.warm_nodes
    }

    /// Forgets the last path: an episode begins.
    pub fn forget(&mut self) {
        self.memory = None;
    }

    /// Plans for one admitted observation: grid, goal, tree, path (Sec. 4.1.1).
    ///
    /// Writes all of `out` except the producer and sequence number of its header
    /// and the planning time, which are the caller's. Nothing of an earlier plan
    /// is left but the path it begins with. The work is bounded by the
    /// configuration; it does not allocate.
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
        self.grid.fill(observation);
        let goal_body = choose_goal(&self.grid, &self.config, observation);
        #[cfg(feature = "std")]
        self.grid.level(goal_body.x);
        prepared();
        let region = Region::before(goal_body, &self.grid);
        self.search.restart(&region, &self.config);
        self.warm_nodes = 0;
        let sampler = Sampler::new(self.config.seed, &observation.header);
        widely(
            #[inline(always)]
            || {
                let mut spent = self.remember(observation);
                spent += self.connect(goal_body, self.config.iterations - spent);
                self.grow(goal_body, &region, sampler, spent);
            },
        );
        *out = Plan {
            goal_x_body_m: goal_body.x,
            goal_y_body_m: goal_body.y,
            iterations: self.config.iterations,
            nodes: self.search.tree.len() as u32,
            ..header(observation, out)
        };
        write_outcome(&self.config, &mut self.search, goal_body, out);
        self.memory = Some(Memory {
            header: observation.header,
            world_from_plan: out.world_from_plan(),
            points_plan: out.waypoints().iter().map(|point| point.point()).collect(),
        });
    }

    /// Makes the points of the last path that are ahead the first nodes; returns the
    /// iterations used.
    fn remember(&mut self, observation: &Observation) -> u32 {
        let limit_ns = (self.settings.memory_s * 1e9) as u64;
        let Some(memory) = &self.memory else { return 0 };
        if !memory.is_followed_by(&observation.header, limit_ns) {
            return 0;
        }
        let ego = &observation.ego;
        let world_from_body = pose(ego.x_world_m, ego.y_world_m, ego.heading_world_rad);
        let body_from_plan = world_from_body.inv_mul(&memory.world_from_plan);
        // The first point is where the car was.
        let ahead = memory.points_plan.iter().skip(1);
        let ahead = ahead.map(|point| body_from_plan * point);
        let (mut spent, mut last) = (0, 0);
        for point_body in ahead.skip_while(|point_body| point_body.x <= 0.0) {
            if spent == self.config.iterations {
                break;
            }
            spent += 1;
            match self
                .search
                .insert(&self.grid, &self.config, last, point_body)
            {
                Some(index) => last = index,
                None => break,
            }
            self.warm_nodes += 1;
        }
        spent
    }

    /// Extends the node nearest to the goal straight to it; returns the iterations used,
    /// at most `most`.
    #[inline(always)]
    fn connect(&mut self, goal_body: Point, most: u32) -> u32 {
        for spent in 0..most {
            let before = self.search.tree.len();
            let reached = self.search.reached(goal_body, self.config.goal_radius_m);
            if reached.is_some() {
                return spent;
            }
            self.search.extend(&self.grid, &self.config, goal_body);
            if self.search.tree.len() == before {
                return spent + 1;
            }
        }
        most
    }

    /// Spends the rest of the budget on samples.
    #[inline(always)]
    fn grow(&mut self, goal_body: Point, region: &Region, mut sampler: Sampler, spent: u32) {
        for _ in spent..self.config.iterations {
            let best = self.search.reached(goal_body, self.config.goal_radius_m);
            let biased = self.config.goal_bias > 0.0 && sampler.unit() < self.config.goal_bias;
            let sample_body = match best {
                _ if biased => goal_body,
                None => sampler.point_body(region),
                Some(best) => {
                    let cost_m = self.search.tree.cost_m(best) + self.config.goal_radius_m;
                    Ellipse::new(goal_body, cost_m).point_body(region, &mut sampler)
                }
            };
            self.search.extend(&self.grid, &self.config, sample_body);
        }
    }
}

impl Memory {
    /// Whether an observation is the one right after, and soon enough.
    fn is_followed_by(&self, next: &Header, limit_ns: u64) -> bool {
        let age_ns = next.taken_ns.checked_sub(self.header.taken_ns);
        next.episode == self.header.episode
            && Some(next.tick) == self.header.tick.checked_add(1)
            && age_ns.is_some_and(|age_ns| age_ns <= limit_ns)
    }
}
