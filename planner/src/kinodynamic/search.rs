use core::f64::consts::TAU;
use shm_config::settings::planner::NODES_MAX;

#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Point, Pose, Vector};

use super::body::Body;
use crate::buckets::{LANES, Spread};
use crate::dubins::Dubins;
use crate::grid::Grid;
use crate::tree::{CHUNKS_MAX, Edge, Tree};

/// Shorter curves are not edges, m.
const SAME_M: f64 = 1e-6;
/// Of two costs that differ by less the first counts, m: rounding alone must
/// not rewire the tree.
const EQUAL_M: f64 = 1e-9;

/// Of the nodes in reach, so many through which the way can cost least may become
/// the parent; that many curves at most are looked at on the grid. Where none of
/// them is free, the sample is behind something. k-nearest RRT* (Karaman & Frazzoli
/// 2011) takes 2e ln n, 19 of 33 nodes: as many goals of 500 scenes are reached,
/// and the slowest plans take an eighth longer.
const PARENTS_MAX: usize = 8;
/// Curves computed to rewire around one node.
const REWIRES_MAX: usize = 8;

/// What one search is about.
#[derive(Debug, Clone, Copy)]
pub(super) struct Question {
    pub(super) body: Body,
    /// Least radius of a turn, m.
    pub(super) radius_m: f64,
    /// Parents and rewired nodes are within this distance, m.
    pub(super) reach_m: f64,
    pub(super) goal: Pose,
}

/// A node that may become the parent of a new one.
#[derive(Debug, Clone, Copy, Default)]
struct Candidate {
    index: usize,
    /// The least that the way through it can cost, m.
    cost_via_m: f64,
    /// The curve from it, once computed: then that is what it does cost.
    curve: Option<Dubins>,
}

/// RRT* over poses, with all its memory. Edges are shortest Dubins curves.
#[derive(Debug)]
pub struct Search {
    pub(super) tree: Tree,
    /// The pose of each node of the tree.
    pub(super) poses: heapless::Vec<Pose, NODES_MAX>,
    /// The heading of each, rad.
    headings_rad: heapless::Vec<f64, NODES_MAX>,
    /// The node at the goal, once there is one.
    pub(super) goal: Option<usize>,
    candidates: heapless::Vec<Candidate, NODES_MAX>,
    squares: [[f64; LANES]; CHUNKS_MAX],
}

impl Search {
    /// Without nodes.
    pub const fn empty() -> Self {
        Self {
            tree: Tree::new(),
            poses: heapless::Vec::new(),
            headings_rad: heapless::Vec::new(),
            goal: None,
            candidates: heapless::Vec::new(),
            squares: [[0.0; LANES]; CHUNKS_MAX],
        }
    }

    /// Only the car is left, and the way to the goal if a single curve is one.
    pub(super) fn restart(&mut self, grid: &Grid, question: &Question) {
        self.tree.restart(Point::origin(), &Spread::UNKNOWN);
        self.poses.clear();
        self.headings_rad.clear();
        self.goal = None;
        let _ = self.poses.push(Pose::identity());
        let _ = self.headings_rad.push(0.0);
        self.reach_goal(grid, question, 0);
    }

    /// One iteration: connect a sample, or what of the way to it is in reach, to
    /// its cheapest parent; rewire; try the goal from there.
    ///
    /// A sample is skipped if no path through it can be shorter than the best path to the
    /// goal (Gammell et al. 2014, with the curves from the start
    /// and to the goal, obstacles ignored, as the least costs).
    pub(super) fn extend(&mut self, grid: &Grid, question: &Question, sample: &Pose) {
        let Some(at) = self.approach(question, sample) else {
            return;
        };
        if !self.can_help(question, &at) || !question.body.is_free_at(grid, &at) {
            return;
        }
        let heading_rad = at.rotation.angle();
        self.find_near(question, &at, heading_rad);
        let Some(edge) = self.choose_parent(grid, question, &at) else {
            return;
        };
        let Some(index) = self.push(&at, heading_rad, edge) else {
            return;
        };
        self.rewire(grid, question, index);
        self.reach_goal(grid, question, index);
    }

    /// The sample, or the place as far along the curve to it as the reach is,
    /// when every node is farther away.
    fn approach(&mut self, question: &Question, sample: &Pose) -> Option<Pose> {
        let (nearest, square) = self.tree.nearest(sample.translation.vector.into());
        if square.is_nan() || square < SAME_M * SAME_M {
            return None;
        }
        if square <= question.reach_m * question.reach_m {
            return Some(*sample);
        }
        let from = self.poses[nearest];
        let curve = Dubins::shortest(&from, sample, question.radius_m);
        Some(curve.at(&from, question.reach_m))
    }

    /// Whether a way through a pose may be shorter than the one to the goal.
    fn can_help(&self, question: &Question, at: &Pose) -> bool {
        let Some(goal) = self.goal else {
            return true;
        };
        let cost_m = self.tree.cost_m(goal);
        let way: Vector = question.goal.translation.vector - at.translation.vector;
        // The straight lines alone exclude most samples.
        if at.translation.vector.norm() + way.norm() >= cost_m {
            return false;
        }
        let curve_m =
            |from: &Pose, to: &Pose| Dubins::shortest(from, to, question.radius_m).length_m();
        curve_m(&self.poses[0], at) + curve_m(at, &question.goal) < cost_m
    }

    /// Whether the way to the goal is the shortest there can be: the one curve
    /// from the start, shorter than which no chain of curves is.
    pub(super) fn is_done(&self) -> bool {
        let parent = |goal| self.tree.node(goal).and_then(|node| node.parent);
        self.goal.is_some_and(|goal| parent(goal) == Some(0))
    }

    /// The least a curve between two poses can be long, m: no less than the
    /// straight line, no less than the arc of the turn, which is the difference
    /// of two headings.
    fn least_m(square: f64, turn_rad: f64, radius_m: f64) -> f64 {
        let turn_rad = turn_rad.abs();
        square.sqrt().max(radius_m * turn_rad.min(TAU - turn_rad))
    }

    /// Collects the nodes in reach, with the least the way through each can cost;
    /// those that may become parents, because it is least there, come first.
    fn find_near(&mut self, question: &Question, at: &Pose, heading_rad: f64) {
        let limit = question.reach_m * question.reach_m * (1.0 + 1e-9);
        let squares = self
            .tree
            .write_squares(at.translation.vector.into(), &mut self.squares);
        self.candidates.clear();
        for (index, &square) in squares.iter().enumerate() {
            if square > limit || Some(index) == self.goal {
                continue;
            }
            let turn_rad = heading_rad - self.headings_rad[index];
            let least_m = Self::least_m(square, turn_rad, question.radius_m);
            let _ = self.candidates.push(Candidate {
                index,
                cost_via_m: self.tree.cost_m(index) + least_m,
                curve: None,
            });
        }
        if self.candidates.len() > PARENTS_MAX {
            self.candidates.select_nth_unstable_by(PARENTS_MAX, |a, b| {
                let by_cost = a.cost_via_m.total_cmp(&b.cost_via_m);
                by_cost.then(a.index.cmp(&b.index))
            });
        }
    }

    /// The cheapest parent whose curve is free. Curves are computed only where
    /// the least they can cost is the least of all, and looked at on the grid
    /// only where what they do cost is.
    fn choose_parent(&mut self, grid: &Grid, question: &Question, at: &Pose) -> Option<Edge> {
        let parents = self.candidates.len().min(PARENTS_MAX);
        loop {
            let best = self.candidates[..parents]
                .iter_mut()
                .min_by(|a, b| a.cost_via_m.total_cmp(&b.cost_via_m))
                .filter(|best| best.cost_via_m.is_finite())?;
            let from = self.poses[best.index];
            let Some(curve) = best.curve else {
                let curve = Dubins::shortest(&from, at, question.radius_m);
                // At least what it was: rounding must not make it look nearer.
                let cost_m = self.tree.cost_m(best.index) + curve.length_m();
                best.cost_via_m = best.cost_via_m.max(cost_m);
                best.curve = Some(curve);
                continue;
            };
            let length_m = curve.length_m();
            if length_m > SAME_M && question.body.is_free_along(grid, &from, &curve) {
                return Some(Edge {
                    parent: best.index,
                    length_m,
                });
            }
            best.cost_via_m = f64::INFINITY;
        }
    }

    fn push(&mut self, at: &Pose, heading_rad: f64, edge: Edge) -> Option<usize> {
        let index = self.tree.push(at.translation.vector.into(), edge)?;
        self.poses.push(*at).ok()?;
        self.headings_rad.push(heading_rad).ok()?;
        Some(index)
    }

    /// Makes the new node the parent of nodes in reach that it makes cheaper.
    fn rewire(&mut self, grid: &Grid, question: &Question, index: usize) {
        let from = self.poses[index];
        let cost_m = self.tree.cost_m(index);
        let mut rewires = 0;
        for at in 0..self.candidates.len() {
            let other = self.candidates[at].index;
            let turn_rad = self.headings_rad[other] - self.headings_rad[index];
            let square = self.squares.as_flattened()[other];
            let least_m = cost_m + Self::least_m(square, turn_rad, question.radius_m);
            if least_m < self.tree.cost_m(other) - EQUAL_M {
                self.hang_if_cheaper(grid, question, (index, &from), other);
                rewires += 1;
                if rewires == REWIRES_MAX {
                    return;
                }
            }
        }
    }

    /// Rewires one node when the curve to it is free and makes it cheaper.
    fn hang_if_cheaper(
        &mut self,
        grid: &Grid,
        question: &Question,
        (parent, from): (usize, &Pose),
        other: usize,
    ) {
        let curve = Dubins::shortest(from, &self.poses[other], question.radius_m);
        let length_m = curve.length_m();
        let cheaper = self.tree.cost_m(parent) + length_m < self.tree.cost_m(other) - EQUAL_M;
        if cheaper && question.body.is_free_along(grid, from, &curve) {
            self.tree.rewire(other, Edge { parent, length_m });
        }
    }

    /// Makes a node the one before the goal, if that is the shortest way there.
    /// The distance does not count: a curve that leads to the goal is one.
    fn reach_goal(&mut self, grid: &Grid, question: &Question, index: usize) {
        let from = self.poses[index];
        match self.goal {
            Some(goal) => {
                if self.can_help_from(question, index, goal) {
                    self.hang_if_cheaper(grid, question, (index, &from), goal);
                }
            }
            None => {
                let curve = Dubins::shortest(&from, &question.goal, question.radius_m);
                let length_m = curve.length_m();
                if length_m > SAME_M && question.body.is_free_along(grid, &from, &curve) {
                    let edge = Edge {
                        parent: index,
                        length_m,
                    };
                    self.goal = self.push(&question.goal, question.goal.rotation.angle(), edge);
                }
            }
        }
    }

    fn can_help_from(&self, question: &Question, index: usize, goal: usize) -> bool {
        let from = self.tree.point(index);
        let way: Vector = question.goal.translation.vector - from.coords;
        self.tree.cost_m(index) + way.norm() < self.tree.cost_m(goal) - EQUAL_M
    }
}
