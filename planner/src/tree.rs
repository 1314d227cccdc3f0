use vehicle::Point;

use shm_config::config::planner::NODES_MAX;

/// Stands for "no node" among indices.
const NONE: u16 = u16::MAX;
/// Nodes compared at a time.
const LANES: usize = 4;

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
#[derive(Debug, Default)]
pub struct Tree {
    x_m: heapless::Vec<f64, NODES_MAX>,
    y_m: heapless::Vec<f64, NODES_MAX>,
    cost_m: heapless::Vec<f64, NODES_MAX>,
    links: heapless::Vec<Links, NODES_MAX>,
}

/// How a node hangs in the tree. The children of a node are a linked list.
#[derive(Debug, Clone, Copy)]
struct Links {
    parent: u16,
    first_child: u16,
    next_sibling: u16,
    /// Length of the edge to the parent, m.
    edge_m: f64,
}

/// A way to hang a node: which parent, how far away.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    pub(crate) parent: usize,
    pub(crate) length_m: f64,
}

impl Tree {
    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.links.len()
    }

    /// Whether there is not even a start; so before the first plan.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }

    /// A node by its index; `None` beyond the last.
    pub fn node(&self, index: usize) -> Option<Node> {
        let links = self.links.get(index)?;
        Some(Node {
            point_body: self.point(index),
            parent: (links.parent != NONE).then_some(links.parent as usize),
            cost_m: self.cost_m[index],
        })
    }

    /// All nodes in the order they were made, the start first.
    pub fn nodes(&self) -> impl Iterator<Item = Node> + '_ {
        (0..self.len()).filter_map(|index| self.node(index))
    }

    /// The indices from a node to the start, both included.
    pub(crate) fn way_back(&self, from: usize) -> impl Iterator<Item = usize> + '_ {
        std::iter::successors(Some(from), |&index| {
            let parent = self.links[index].parent;
            (parent != NONE).then_some(parent as usize)
        })
    }

    pub(crate) fn point(&self, index: usize) -> Point {
        Point::new(self.x_m[index], self.y_m[index])
    }

    pub(crate) fn cost_m(&self, index: usize) -> f64 {
        self.cost_m[index]
    }

    /// Writes the squared distance of each node to a point, m², into the
    /// beginning of `squares`, and returns that.
    pub(crate) fn write_squares<'a>(
        &self,
        point_body: Point,
        squares: &'a mut [f64; NODES_MAX],
    ) -> &'a [f64] {
        // Three slices of one length: the loop becomes one of vectors.
        let squares = &mut squares[..self.len()];
        let (x_m, y_m) = (&self.x_m[..squares.len()], &self.y_m[..squares.len()]);
        for (index, square) in squares.iter_mut().enumerate() {
            let (dx_m, dy_m) = (x_m[index] - point_body.x, y_m[index] - point_body.y);
            *square = dx_m * dx_m + dy_m * dy_m;
        }
        squares
    }

    /// The nearest node and its squared distance, m²; of equals the first.
    pub(crate) fn nearest(&self, point_body: Point) -> (usize, f64) {
        // Lanes make the loop one of vectors; a single running minimum is a
        // chain of dependent comparisons.
        let Point { coords } = point_body;
        let (x_lanes, x_rest) = self.x_m.as_chunks::<LANES>();
        let (y_lanes, y_rest) = self.y_m.as_chunks::<LANES>();
        let mut least = [f64::INFINITY; LANES];
        // Counts chunks; of the same width as the distances, so that both are
        // selected by one comparison.
        let mut at = [0.0; LANES];
        for (chunk, (x_m, y_m)) in x_lanes.iter().zip(y_lanes).enumerate() {
            let chunk = chunk as f64;
            for lane in 0..LANES {
                let (dx_m, dy_m) = (x_m[lane] - coords.x, y_m[lane] - coords.y);
                let square = dx_m * dx_m + dy_m * dy_m;
                let nearer = square < least[lane];
                least[lane] = if nearer { square } else { least[lane] };
                at[lane] = if nearer { chunk } else { at[lane] };
            }
        }
        let mut best = (0, f64::INFINITY);
        for lane in 0..LANES {
            let index = at[lane] as usize * LANES + lane;
            if least[lane] < best.1 || (least[lane] == best.1 && index < best.0) {
                best = (index, least[lane]);
            }
        }
        let rest = self.len() - x_rest.len();
        for (offset, (x_m, y_m)) in x_rest.iter().zip(y_rest).enumerate() {
            let (dx_m, dy_m) = (x_m - coords.x, y_m - coords.y);
            let square = dx_m * dx_m + dy_m * dy_m;
            if square < best.1 {
                best = (rest + offset, square);
            }
        }
        best
    }

    /// Only the start is left, at this point.
    pub(crate) fn restart(&mut self, start_body: Point) {
        self.x_m.clear();
        self.y_m.clear();
        self.cost_m.clear();
        self.links.clear();
        self.add(start_body, 0.0, 0.0, NONE);
    }

    /// A new node; its index, or `None` when the tree is full.
    pub(crate) fn push(&mut self, point_body: Point, edge: Edge) -> Option<usize> {
        let index = self.len();
        let cost_m = self.cost_m[edge.parent] + edge.length_m;
        if !self.add(point_body, cost_m, edge.length_m, NONE) {
            return None;
        }
        self.hang(index, edge);
        Some(index)
    }

    fn add(&mut self, point_body: Point, cost_m: f64, edge_m: f64, parent: u16) -> bool {
        let links = Links {
            parent,
            first_child: NONE,
            next_sibling: NONE,
            edge_m,
        };
        self.x_m.push(point_body.x).is_ok()
            && self.y_m.push(point_body.y).is_ok()
            && self.cost_m.push(cost_m).is_ok()
            && self.links.push(links).is_ok()
    }

    /// Makes a node the first child of a parent.
    fn hang(&mut self, index: usize, edge: Edge) {
        let next_sibling = self.links[edge.parent].first_child;
        self.links[edge.parent].first_child = index as u16;
        let links = &mut self.links[index];
        links.parent = edge.parent as u16;
        links.next_sibling = next_sibling;
        links.edge_m = edge.length_m;
    }

    /// Takes a node, with everything behind it, to a new parent, and brings the
    /// costs of everything behind it up to date.
    ///
    /// The new parent must not be behind the node; a parent that makes the node
    /// cheaper never is.
    pub(crate) fn rewire(&mut self, index: usize, edge: Edge) {
        let parent = self.links[index].parent as usize;
        let after = self.links[index].next_sibling;
        if self.links[parent].first_child == index as u16 {
            self.links[parent].first_child = after;
        } else {
            let mut sibling = self.links[parent].first_child as usize;
            while self.links[sibling].next_sibling != index as u16 {
                sibling = self.links[sibling].next_sibling as usize;
            }
            self.links[sibling].next_sibling = after;
        }
        self.hang(index, edge);
        self.refresh(index);
    }

    /// Recomputes the cost of a node and of all behind it, parents first. The
    /// walk follows the links, so it needs neither a stack nor recursion.
    fn refresh(&mut self, top: usize) {
        let mut at = top;
        loop {
            let links = self.links[at];
            self.cost_m[at] = self.cost_m[links.parent as usize] + links.edge_m;
            if links.first_child != NONE {
                at = links.first_child as usize;
                continue;
            }
            while at != top && self.links[at].next_sibling == NONE {
                at = self.links[at].parent as usize;
            }
            if at == top {
                return;
            }
            at = self.links[at].next_sibling as usize;
        }
    }
}
