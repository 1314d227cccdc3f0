#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::Point;

use crate::PlannerConfig;
use crate::grid::Grid;
use crate::sampler::{Region, Sampler};
use crate::tree::{CHUNKS_MAX, Edge, LANES, Tree, lane_of, least_chunk};

/// A sample this close to a node is that node, m; a tree of equal points would
/// have edges of no length.
const SAME_M: f64 = 1e-6;

/// What the nodes of a chunk are to a new node; infinite outside the rewire
/// radius.
#[derive(Debug, Clone, Copy)]
struct Near {
    distance_m: [f64; LANES],
    /// Cost of the new node with each as its parent, m; infinite once the edge
    /// turned out to be blocked.
    cost_via_m: [f64; LANES],
}

/// RRT* of Sec. 4.1.1 with all its memory.
#[derive(Debug)]
pub struct Search {
    pub(crate) tree: Tree,
    /// As many count as the tree had chunks before the new node.
    near: [Near; CHUNKS_MAX],
    near_count: usize,
}

impl Search {
    /// Without nodes.
    pub const fn empty() -> Self {
        let none = Near {
            distance_m: [f64::INFINITY; LANES],
            cost_via_m: [f64::INFINITY; LANES],
        };
        Self {
            tree: Tree::new(),
            near: [none; CHUNKS_MAX],
            near_count: 0,
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
        let least = self.find_near(point_body, config.rewire_radius_m);
        let edge = self.choose_parent(
            grid,
            point_body,
            least,
            Edge {
                parent: from,
                // The distance between the points as stored, not the step: costs are then
                // exact sums.
                length_m: (point_body - from_body).norm_squared().sqrt(),
            },
        );
        let index = self.tree.push(point_body, edge)?;
        self.rewire(grid, index);
        Some(index)
    }

    /// Measures the way from every node within the radius; the chunk with the
    /// cheapest parent, and the new node's cost with that one, m.
    ///
    /// The loop covers all nodes, also those outside the radius: at the paper's 200
    /// iterations a vectorised loop over all is cheaper than a selection of the nodes
    /// inside, and than buckets.
    fn find_near(&mut self, point_body: Point, radius_m: f64) -> (usize, f64) {
        let limit = radius_m * radius_m;
        let chunks = self.tree.chunks();
        self.near_count = chunks.len();
        least_chunk(self.near.iter_mut().zip(chunks).map(|(near, chunk)| {
            let squares = chunk.squares(point_body);
            for (lane, &square) in squares.iter().enumerate() {
                let distance_m = square.sqrt();
                let distance_m = if square <= limit {
                    distance_m
                } else {
                    f64::INFINITY
                };
                near.distance_m[lane] = distance_m;
                near.cost_via_m[lane] = chunk.cost_m[lane] + distance_m;
            }
            near.cost_via_m
        }))
    }

    /// The cheapest parent with a free edge. The nearest node, whose edge is
    /// known to be free, is the fallback; so only cheaper ones are looked at,
    /// the cheapest first, and most searches test a single edge.
    fn choose_parent(
        &mut self,
        grid: &Grid,
        point_body: Point,
        mut least: (usize, f64),
        nearest: Edge,
    ) -> Edge {
        let limit_m = self.tree.cost_m(nearest.parent) + nearest.length_m;
        let near = &mut self.near[..self.near_count];
        loop {
            let (at, cost_m) = least;
            if cost_m >= limit_m {
                return nearest;
            }
            let chunk = &mut near[at];
            let lane = lane_of(&chunk.cost_via_m, cost_m);
            let parent = at * LANES + lane;
            if grid.is_segment_free(self.tree.point(parent), point_body) {
                return Edge {
                    parent,
                    length_m: chunk.distance_m[lane],
                };
            }
            chunk.cost_via_m[lane] = f64::INFINITY;
            least = least_chunk(near.iter().map(|near| near.cost_via_m));
        }
    }

    /// Makes the new node the parent of each near node that it makes cheaper.
    fn rewire(&mut self, grid: &Grid, index: usize) {
        let point_body = self.tree.point(index);
        let cost_m = self.tree.cost_m(index);
        for (chunk, near) in self.near[..self.near_count].iter().enumerate() {
            let costs_m = self.tree.chunks()[chunk].cost_m;
            let mut any = false;
            for (distance_m, old_m) in near.distance_m.iter().zip(costs_m) {
                any |= cost_m + distance_m < old_m;
            }
            if !any {
                continue;
            }
            for (lane, &distance_m) in near.distance_m.iter().enumerate() {
                let other = chunk * LANES + lane;
                // Rewiring only lowers costs; so no node that the test of the whole
                // chunk excluded would pass now.
                if cost_m + distance_m < self.tree.cost_m(other)
                    && grid.is_segment_free(point_body, self.tree.point(other))
                {
                    let edge = Edge {
                        parent: index,
                        length_m: distance_m,
                    };
                    self.tree.rewire(other, edge);
                }
            }
        }
    }

    /// The cheapest node in the goal ball.
    pub(crate) fn reached(&self, goal_body: Point, radius_m: f64) -> Option<usize> {
        let in_ball = |&index: &usize| {
            (self.tree.point(index) - goal_body).norm_squared() <= radius_m * radius_m
        };
        (0..self.tree.len())
            .filter(in_ball)
            .min_by(|&a, &b| self.tree.cost_m(a).total_cmp(&self.tree.cost_m(b)))
    }
}
