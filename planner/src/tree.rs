#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::Point;

use shm_config::settings::planner::NODES_MAX;

use crate::buckets::{Buckets, Found, LANES, Reach, Spread, Via};

/// Stands for "no node" among indices.
const NONE: u16 = u16::MAX;
/// Pieces of the distances to the nodes of a full tree.
pub(crate) const CHUNKS_MAX: usize = NODES_MAX.div_ceil(LANES);

/// One node of the tree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Node {
    /// Where it is, in the body frame, m.
    pub point_body: Point,
    /// The node before it on the way from the start; `None` at the start itself.
    pub parent: Option<usize>,
    /// Length of the way from the start, m: the sum of the edges.
    pub cost_m: f64,
}

/// The tree of RRT*, in fixed arrays. Node 0 is the start; a node keeps its
/// index from the iteration that made it on.
#[derive(Debug)]
pub struct Tree {
    records: heapless::Vec<Record, NODES_MAX>,
    buckets: Buckets,
}

/// A node and its links in the tree. The children of a node are a linked list.
#[derive(Debug, Clone, Copy)]
struct Record {
    point_body: Point,
    cost_m: f64,
    /// Length of the edge to the parent, m.
    edge_m: f64,
    parent: u16,
    first_child: u16,
    next_sibling: u16,
    /// A node of a tree in the open has hundreds of children: a search for the one before
    /// would cost more than the rewiring.
    previous_sibling: u16,
    /// Where it is among the buckets.
    slot: u16,
}

/// A possible edge to a parent, and its length.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    pub(crate) parent: usize,
    pub(crate) length_m: f64,
}

impl Default for Tree {
    fn default() -> Self {
        Self::new()
    }
}

impl Tree {
    /// Empty.
    pub const fn new() -> Self {
        Self {
            records: heapless::Vec::new(),
            buckets: Buckets::new(),
        }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether there is not even a start; so before the first plan.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// A node by its index; `None` beyond the last.
    pub fn node(&self, index: usize) -> Option<Node> {
        let record = self.records.get(index)?;
        Some(Node {
            point_body: record.point_body,
            parent: (record.parent != NONE).then_some(record.parent as usize),
            cost_m: record.cost_m,
        })
    }

    /// All nodes in the order they were made, the start first.
    pub fn nodes(&self) -> impl Iterator<Item = Node> + '_ {
        (0..self.len()).filter_map(|index| self.node(index))
    }

    /// The indices from a node to the start, both included.
    pub(crate) fn way_back(&self, from: usize) -> impl Iterator<Item = usize> + '_ {
        core::iter::successors(Some(from), |&index| {
            let parent = self.records[index].parent;
            (parent != NONE).then_some(parent as usize)
        })
    }

    pub(crate) fn point(&self, index: usize) -> Point {
        self.records[index].point_body
    }

    pub(crate) fn cost_m(&self, index: usize) -> f64 {
        self.records[index].cost_m
    }

    /// Writes the squared distance of each node to a point, m², into the beginning of
    /// `squares`, and returns that. The tree was restarted with [`Spread::UNKNOWN`].
    pub(crate) fn write_squares<'a>(
        &self,
        point_body: Point,
        squares: &'a mut [[f64; LANES]; CHUNKS_MAX],
    ) -> &'a [f64] {
        self.buckets.write_squares(point_body, squares);
        &squares.as_flattened()[..self.len()]
    }

    /// The nearest node and its squared distance, m²; of equals the first.
    #[inline(always)]
    pub(crate) fn nearest(&mut self, point_body: Point) -> (usize, f64) {
        self.buckets.nearest(point_body)
    }

    /// Measures the buckets from a point, for the calls of [`Tree::each_within`] after it.
    #[inline(always)]
    pub(crate) fn measure(&mut self, point_body: Point) {
        self.buckets.measure(point_body);
    }

    /// See [`Buckets::cheapest_via`].
    #[inline(always)]
    pub(crate) fn cheapest_via(
        &self,
        point_body: Point,
        radius_m: f64,
        known: Via,
        after: Option<Via>,
    ) -> Option<Via> {
        self.buckets
            .cheapest_via(point_body, radius_m, known, after)
    }

    /// The shortest way to a point through an ancestor of a node, of equals the nearest to the
    /// node; or the way that is known if none is shorter. Ancestors behind the first that is
    /// farther away than a radius, m, are left out: the way is a limit for the search of all.
    #[inline(always)]
    pub(crate) fn via_ancestor(
        &self,
        from: usize,
        point_body: Point,
        radius_m: f64,
        mut known: Via,
    ) -> Via {
        let mut at = self.records[from].parent;
        while at != NONE {
            let record = &self.records[at as usize];
            let square = (record.point_body - point_body).norm_squared();
            if square > radius_m * radius_m {
                break;
            }
            let cost_m = square.sqrt() + record.cost_m;
            if cost_m < known.cost_m {
                known = Via {
                    cost_m,
                    index: f64::from(at),
                };
            }
            at = record.parent;
        }
        known
    }

    /// Calls a function with each node within reach of the point that was measured, and
    /// with some a little farther away by their costs, in no particular order.
    #[inline(always)]
    pub(crate) fn each_within(
        &mut self,
        point_body: Point,
        reach: Reach,
        found: impl FnMut(Found),
    ) {
        self.buckets.each_within(point_body, reach, found);
    }

    /// Only the start is left, at this point.
    pub(crate) fn restart(&mut self, start_body: Point, spread: &Spread) {
        self.records.clear();
        self.buckets.restart(spread);
        self.add(start_body, 0.0, 0.0);
    }

    /// A new node; its index, or `None` when the tree is full.
    pub(crate) fn push(&mut self, point_body: Point, edge: Edge) -> Option<usize> {
        let index = self.len();
        let cost_m = self.cost_m(edge.parent) + edge.length_m;
        if !self.add(point_body, cost_m, edge.length_m) {
            return None;
        }
        self.hang(index, edge);
        Some(index)
    }

    fn add(&mut self, point_body: Point, cost_m: f64, edge_m: f64) -> bool {
        if self.records.is_full() {
            return false;
        }
        let index = self.len() as u16;
        let Some(slot) = self.buckets.push(index, point_body, cost_m) else {
            return false;
        };
        let record = Record {
            point_body,
            cost_m,
            edge_m,
            parent: NONE,
            first_child: NONE,
            next_sibling: NONE,
            previous_sibling: NONE,
            slot,
        };
        self.records.push(record).is_ok()
    }

    /// Makes a node the first child of a parent.
    fn hang(&mut self, index: usize, edge: Edge) {
        let next_sibling = self.records[edge.parent].first_child;
        self.records[edge.parent].first_child = index as u16;
        if next_sibling != NONE {
            self.records[next_sibling as usize].previous_sibling = index as u16;
        }
        let record = &mut self.records[index];
        record.parent = edge.parent as u16;
        record.next_sibling = next_sibling;
        record.previous_sibling = NONE;
        record.edge_m = edge.length_m;
    }

    /// Moves a node with its subtree to a new parent, and updates the costs of the
    /// subtree.
    ///
    /// The new parent must not be in the subtree; a parent that makes the node cheaper
    /// never is.
    pub(crate) fn rewire(&mut self, index: usize, edge: Edge) {
        let Record {
            parent,
            next_sibling,
            previous_sibling,
            ..
        } = self.records[index];
        match previous_sibling {
            NONE => self.records[parent as usize].first_child = next_sibling,
            _ => self.records[previous_sibling as usize].next_sibling = next_sibling,
        }
        if next_sibling != NONE {
            self.records[next_sibling as usize].previous_sibling = previous_sibling;
        }
        self.hang(index, edge);
        self.refresh(index);
    }

    /// Recomputes the costs of a node's subtree, parents first. The walk follows the
    /// links, so it needs neither a stack nor recursion.
    fn refresh(&mut self, top: usize) {
        let mut at = top;
        loop {
            let cost_m = self.cost_m(self.records[at].parent as usize) + self.records[at].edge_m;
            let record = &mut self.records[at];
            record.cost_m = cost_m;
            let Record {
                slot, first_child, ..
            } = *record;
            self.buckets.lower(slot, cost_m);
            if first_child != NONE {
                at = first_child as usize;
                continue;
            }
            while at != top && self.records[at].next_sibling == NONE {
                at = self.records[at].parent as usize;
            }
            if at == top {
                return;
            }
            at = self.records[at].next_sibling as usize;
        }
    }
}
