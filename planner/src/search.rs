use core::f64::consts::PI;

use shm_config::settings::planner::NODES_MAX;
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::Point;

use crate::PlannerConfig;
use crate::buckets::{Found, Reach, Spread, Via};
use crate::grid::Grid;
use crate::sampler::{Region, Sampler};
use crate::tree::{Edge, Tree};

/// A sample this close to a node is that node, m; a tree of equal points would
/// have edges of no length.
const SAME_M: f64 = 1e-6;

/// RRT* of Sec. 4.1.1 with all its memory.
#[derive(Debug)]
pub struct Search {
    pub(crate) tree: Tree,
    /// The radius of `n` nodes is this times the square root of `ln n / n`, m.
    gamma_m: f64,
    children: heapless::Vec<u16, NODES_MAX>,
}

impl Search {
    /// Without nodes.
    pub const fn empty() -> Self {
        Self {
            tree: Tree::new(),
            gamma_m: 0.0,
            children: heapless::Vec::new(),
        }
    }

    /// Only the start is left; the other nodes will be in the region.
    pub(crate) fn restart(&mut self, region: &Region, config: &PlannerConfig) {
        let spread = Spread {
            low: Point::new(0.0, region.right_m),
            high: Point::new(region.x_max_m, region.left_m),
            nodes: config.iterations,
        };
        self.tree.restart(Point::origin(), &spread);
        // 2 (1 + 1/d)^(1/d) (A / zeta_d)^(1/d) for d = 2, where A is the area of the region, m²,
        // and zeta_d that of the unit disc, pi: the square root of 2 times the bound of theorem
        // 38 of Karaman and Frazzoli. Solovey et al. (2020, arXiv:1909.09688) show a gap
        // in its proof; with 4,096 nodes at most, no limit is reached.
        let area = (region.left_m - region.right_m) * region.x_max_m;
        self.gamma_m = 2.0 * (1.5 * area.max(0.0) / PI).sqrt();
    }

    /// In which parents are chosen and edges rewired, m.
    fn radius_m(&self, config: &PlannerConfig) -> f64 {
        let nodes = self.tree.len();
        match nodes <= config.shrink_after as usize {
            true => config.rewire_radius_m,
            false => config.rewire_radius_m.min(self.gamma_m * thinning(nodes)),
        }
    }

    /// Grows a new tree from the origin and always spends the whole budget.
    ///
    /// Each iteration draws one sample, uniform in the region; extends the
    /// nearest node towards it by a step, or up to the sample when that is
    /// nearer; and drops the iteration when the way there is not free.
    pub(crate) fn grow(
        &mut self,
        grid: &Grid,
        config: &PlannerConfig,
        goal_body: Point,
        mut sampler: Sampler,
    ) {
        let region = Region::before(goal_body, grid);
        self.restart(&region, config);
        widely(
            #[inline(always)]
            || {
                for _ in 0..config.iterations {
                    // Without a bias no number is drawn for it.
                    let is_goal = config.goal_bias > 0.0 && sampler.unit() < config.goal_bias;
                    let sample_body = match is_goal {
                        true => goal_body,
                        false => sampler.point_body(&region),
                    };
                    self.extend(grid, config, sample_body);
                }
            },
        );
    }

    /// One iteration: extend, choose the parent, rewire.
    #[inline(always)]
    pub(crate) fn extend(&mut self, grid: &Grid, config: &PlannerConfig, sample_body: Point) {
        let (nearest, square) = self.tree.nearest(sample_body);
        let distance_m = square.sqrt();
        if distance_m < SAME_M {
            return;
        }
        let from_body = self.tree.point(nearest);
        let point_body = if distance_m > config.step_m {
            from_body + (sample_body - from_body) * (config.step_m / distance_m)
        } else {
            sample_body
        };
        self.insert(grid, config, nearest, point_body);
    }

    /// Adds a point that can be reached straight from a node: chooses the parent,
    /// rewires. `None` when the way there is not free, or the tree is full.
    #[inline(always)]
    pub(crate) fn insert(
        &mut self,
        grid: &Grid,
        config: &PlannerConfig,
        from: usize,
        point_body: Point,
    ) -> Option<usize> {
        let from_body = self.tree.point(from);
        if !grid.is_segment_free(from_body, point_body) {
            return None;
        }
        let nearest = Edge {
            parent: from,
            // The distance between the points as stored, not the step: costs are then
            // exact sums.
            length_m: (point_body - from_body).norm_squared().sqrt(),
        };
        let radius_m = self.radius_m(config);
        self.tree.measure(point_body);
        let edge = self.choose_parent(grid, radius_m, point_body, nearest);
        let index = self.tree.push(point_body, edge)?;
        self.rewire(grid, radius_m, index);
        Some(index)
    }

    /// The cheapest parent with a free edge. The nearest node, whose edge is
    /// known to be free, is the fallback; so only cheaper ones are looked at,
    /// the cheapest first, and most searches test a single edge. Of equals the first.
    ///
    /// An ancestor of the nearest node is often the cheapest, or nearly: until an edge is
    /// blocked, only ways that come before the one through it are looked at.
    #[inline(always)]
    fn choose_parent(&self, grid: &Grid, radius_m: f64, point_body: Point, nearest: Edge) -> Edge {
        let fallback = Via::unnamed(self.tree.cost_m(nearest.parent) + nearest.length_m);
        let tree = &self.tree;
        let mut known = tree.via_ancestor(nearest.parent, point_body, radius_m, fallback);
        let mut blocked = None;
        while let Some(via) = tree.cheapest_via(point_body, radius_m, known, blocked) {
            let parent = via.index as usize;
            let parent_body = tree.point(parent);
            if grid.is_segment_free(parent_body, point_body) {
                return Edge {
                    parent,
                    length_m: (parent_body - point_body).norm_squared().sqrt(),
                };
            }
            (known, blocked) = (fallback, Some(via));
        }
        nearest
    }

    /// Makes the new node the parent of each near node that it makes cheaper, in the
    /// order they were made.
    #[inline(always)]
    fn rewire(&mut self, grid: &Grid, radius_m: f64, index: usize) {
        let Self { tree, children, .. } = self;
        let point_body = tree.point(index);
        let cost_m = tree.cost_m(index);
        children.clear();
        let reach = Reach::of_children(cost_m, radius_m);
        tree.each_within(point_body, reach, |found| {
            if cost_m + found.square.sqrt() < found.cost_m {
                let _ = children.push(found.index);
            }
        });
        children.sort_unstable();
        for &other in &*children {
            let other = usize::from(other);
            let other_body = tree.point(other);
            let length_m = (other_body - point_body).norm_squared().sqrt();
            // Rewiring only lowers costs; so all that pass now are among those that
            // passed at the beginning.
            if cost_m + length_m < tree.cost_m(other)
                && grid.is_segment_free(point_body, other_body)
            {
                let edge = Edge {
                    parent: index,
                    length_m,
                };
                tree.rewire(other, edge);
            }
        }
    }

    /// The cheapest node in the goal ball; of equals the first.
    #[inline(always)]
    pub(crate) fn reached(&mut self, goal_body: Point, radius_m: f64) -> Option<usize> {
        let mut best: Option<Found> = None;
        self.tree.measure(goal_body);
        self.tree
            .each_within(goal_body, Reach::of_all(radius_m), |found| {
                let is_better =
                    best.is_none_or(|best| (found.cost_m, found.index) < (best.cost_m, best.index));
                if is_better {
                    best = Some(found);
                }
            });
        best.map(|best| usize::from(best.index))
    }
}

/// The factor of the radius: the square root of ln n / n.
fn thinning(nodes: usize) -> f64 {
    let nodes = nodes as f64;
    (nodes.ln() / nodes).sqrt()
}

/// Calls a function with the widest vectors of this machine, as far as all that it calls is
/// inlined. The width changes no bit of a result: no product and sum are fused.
#[cfg(feature = "std")]
pub(crate) fn widely(run: impl FnOnce()) {
    pulp::Arch::new().dispatch(run);
}

/// Calls a function, with the vectors that the program is built for.
#[cfg(not(feature = "std"))]
pub(crate) fn widely(run: impl FnOnce()) {
    run();
}

#[cfg(test)]
mod tests;
