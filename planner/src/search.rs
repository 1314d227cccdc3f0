use vehicle::Point;

use crate::PlannerConfig;
use crate::grid::Grid;
use crate::sampler::{Region, Sampler};
use crate::tree::{Edge, Tree};
use shm_config::config::planner::NODES_MAX;

/// A sample this close to a node is that node, m; a tree of equal points would
/// have edges of no length.
const SAME_M: f64 = 1e-6;

/// A node within the rewire radius of the new one.
#[derive(Debug, Clone, Copy, Default)]
struct Near {
    index: usize,
    distance_m: f64,
    /// Cost of the new node with this one as its parent, m; infinite once the
    /// edge turned out to be blocked.
    cost_via_m: f64,
}

/// RRT* of Sec. 4.1.1 with all its memory.
#[derive(Debug)]
pub(crate) struct Search {
    pub(crate) tree: Tree,
    /// The first `near_count` are near the new node.
    near: [Near; NODES_MAX],
    near_count: usize,
    /// Squared distance of each node to the new one, m²; scratch.
    squares: [f64; NODES_MAX],
    /// Indices of the nodes inside the radius; scratch.
    inside: [u16; NODES_MAX],
}

impl Search {
    /// An empty tree.
    pub(crate) fn new() -> Self {
        Self {
            tree: Tree::default(),
            near: [Near::default(); NODES_MAX],
            near_count: 0,
            squares: [0.0; NODES_MAX],
            inside: [0; NODES_MAX],
        }
    }

    /// Grows a new tree from the origin: the whole budget, whatever is found.
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
        let corridor = grid.corridor();
        let region = Region {
            x_max_m: goal_body.x.clamp(0.0, grid.x_max_m()),
            right_m: corridor.right_m,
            left_m: corridor.left_m,
        };
        self.tree.restart(Point::origin());
        for _ in 0..config.iterations {
            // Without a bias no number is drawn for it.
            let sample_body = if config.goal_bias > 0.0 && sampler.unit() < config.goal_bias {
                goal_body
            } else {
                sampler.point_body(&region)
            };
            self.extend(grid, config, sample_body);
        }
    }

    /// One iteration: extend, choose the parent, rewire.
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
        self.find_near(point_body, config.rewire_radius_m);
        let edge = self.choose_parent(
            grid,
            point_body,
            Edge {
                parent: from,
                // Of the points as they are, not the step: costs are then exact sums.
                length_m: (point_body - from_body).norm_squared().sqrt(),
            },
        );
        let index = self.tree.push(point_body, edge)?;
        self.rewire(grid, index);
        Some(index)
    }

    /// Collects the nodes within the radius.
    ///
    /// Passes over all nodes: at the paper's 200 iterations they are cheaper than
    /// keeping buckets. The distances are a loop of vectors; then each index is
    /// written down and the count moves on only for those inside, because a
    /// branch would be guessed wrong too often.
    fn find_near(&mut self, point_body: Point, radius_m: f64) {
        let limit = radius_m * radius_m;
        let squares = self.tree.write_squares(point_body, &mut self.squares);
        let mut count = 0;
        for (index, &square) in squares.iter().enumerate() {
            self.inside[count] = index as u16;
            count += usize::from(square <= limit);
        }
        self.near_count = count;
        for (near, &index) in self.near.iter_mut().zip(&self.inside[..count]) {
            let index = usize::from(index);
            let distance_m = squares[index].sqrt();
            *near = Near {
                index,
                distance_m,
                cost_via_m: self.tree.cost_m(index) + distance_m,
            };
        }
    }

    /// The cheapest parent with a free edge. The nearest node, whose edge is
    /// known to be free, is the fallback; so only cheaper ones are looked at,
    /// the cheapest first, and most searches test a single edge.
    fn choose_parent(&mut self, grid: &Grid, point_body: Point, nearest: Edge) -> Edge {
        let limit_m = self.tree.cost_m(nearest.parent) + nearest.length_m;
        loop {
            let mut best: Option<&mut Near> = None;
            for near in &mut self.near[..self.near_count] {
                let least_m = best.as_ref().map_or(limit_m, |best| best.cost_via_m);
                if near.cost_via_m < least_m {
                    best = Some(near);
                }
            }
            let Some(best) = best else {
                return nearest;
            };
            if grid.is_segment_free(self.tree.point(best.index), point_body) {
                return Edge {
                    parent: best.index,
                    length_m: best.distance_m,
                };
            }
            best.cost_via_m = f64::INFINITY;
        }
    }

    /// Makes the new node the parent of each near node that it makes cheaper.
    fn rewire(&mut self, grid: &Grid, index: usize) {
        let point_body = self.tree.point(index);
        let cost_m = self.tree.cost_m(index);
        for near in &self.near[..self.near_count] {
            let cheaper = cost_m + near.distance_m < self.tree.cost_m(near.index);
            if cheaper && grid.is_segment_free(point_body, self.tree.point(near.index)) {
                let edge = Edge {
                    parent: index,
                    length_m: near.distance_m,
                };
                self.tree.rewire(near.index, edge);
            }
        }
    }

    /// Of the nodes in the goal ball the cheapest.
    pub(crate) fn reached(&self, goal_body: Point, radius_m: f64) -> Option<usize> {
        let in_ball = |&index: &usize| {
            (self.tree.point(index) - goal_body).norm_squared() <= radius_m * radius_m
        };
        (0..self.tree.len())
            .filter(in_ball)
            .min_by(|&a, &b| self.tree.cost_m(a).total_cmp(&self.tree.cost_m(b)))
    }
}
