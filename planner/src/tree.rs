use vehicle::Point;

use shm_config::settings::planner::NODES_MAX;

/// Stands for "no node" among indices.
const NONE: u16 = u16::MAX;
/// Nodes of a chunk: the compiler turns loops over this many into vector instructions.
pub(crate) const LANES: usize = 8;
/// Chunks of a full tree.
pub(crate) const CHUNKS_MAX: usize = NODES_MAX.div_ceil(LANES);

/// Nodes with neighbouring indices. Lanes after the last node are infinitely far away,
/// so that a loop over all nodes always processes whole chunks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Chunk {
    x_m: [f64; LANES],
    y_m: [f64; LANES],
    pub(crate) cost_m: [f64; LANES],
}

impl Chunk {
    const EMPTY: Self = Self {
        x_m: [f64::INFINITY; LANES],
        y_m: [f64::INFINITY; LANES],
        cost_m: [f64::INFINITY; LANES],
    };

    /// Squared distances to a point, m².
    pub(crate) fn squares(&self, point_body: Point) -> [f64; LANES] {
        let mut squares = [0.0; LANES];
        for (lane, square) in squares.iter_mut().enumerate() {
            let (dx_m, dy_m) = (self.x_m[lane] - point_body.x, self.y_m[lane] - point_body.y);
            *square = dx_m * dx_m + dy_m * dy_m;
        }
        squares
    }
}

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
    chunks: heapless::Vec<Chunk, CHUNKS_MAX>,
    links: heapless::Vec<Links, NODES_MAX>,
}

/// The links of a node in the tree. The children of a node are a linked list.
#[derive(Debug, Clone, Copy)]
struct Links {
    parent: u16,
    first_child: u16,
    next_sibling: u16,
    /// Length of the edge to the parent, m.
    edge_m: f64,
}

/// A possible edge to a parent, and its length.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Edge {
    pub(crate) parent: usize,
    pub(crate) length_m: f64,
}

impl Tree {
    /// Empty.
    pub const fn new() -> Self {
        Self {
            chunks: heapless::Vec::new(),
            links: heapless::Vec::new(),
        }
    }

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
            cost_m: self.cost_m(index),
        })
    }

    /// All nodes in the order they were made, the start first.
    pub fn nodes(&self) -> impl Iterator<Item = Node> + '_ {
        (0..self.len()).filter_map(|index| self.node(index))
    }

    /// The indices from a node to the start, both included.
    pub(crate) fn way_back(&self, from: usize) -> impl Iterator<Item = usize> + '_ {
        core::iter::successors(Some(from), |&index| {
            let parent = self.links[index].parent;
            (parent != NONE).then_some(parent as usize)
        })
    }

    pub(crate) fn point(&self, index: usize) -> Point {
        let (chunk, lane) = (&self.chunks[index / LANES], index % LANES);
        Point::new(chunk.x_m[lane], chunk.y_m[lane])
    }

    pub(crate) fn cost_m(&self, index: usize) -> f64 {
        self.chunks[index / LANES].cost_m[index % LANES]
    }

    fn set_cost_m(&mut self, index: usize, cost_m: f64) {
        self.chunks[index / LANES].cost_m[index % LANES] = cost_m;
    }

    /// All nodes, chunk by chunk.
    pub(crate) fn chunks(&self) -> &[Chunk] {
        &self.chunks
    }

    /// Writes the squared distance of each node to a point, m², into the
    /// beginning of `squares`, and returns that.
    pub(crate) fn write_squares<'a>(
        &self,
        point_body: Point,
        squares: &'a mut [[f64; LANES]; CHUNKS_MAX],
    ) -> &'a [f64] {
        for (squares, chunk) in squares.iter_mut().zip(&self.chunks) {
            *squares = chunk.squares(point_body);
        }
        &squares.as_flattened()[..self.len()]
    }

    /// The nearest node and its squared distance, m²; of equals the first.
    pub(crate) fn nearest(&self, point_body: Point) -> (usize, f64) {
        let (at, square) = least_chunk(self.chunks.iter().map(|chunk| chunk.squares(point_body)));
        let chunk = self.chunks.get(at);
        let lane = chunk.map_or(0, |chunk| lane_of(&chunk.squares(point_body), square));
        (at * LANES + lane, square)
    }

    /// Only the start is left, at this point.
    pub(crate) fn restart(&mut self, start_body: Point) {
        self.chunks.clear();
        self.links.clear();
        self.add(start_body, 0.0, 0.0, NONE);
    }

    /// A new node; its index, or `None` when the tree is full.
    pub(crate) fn push(&mut self, point_body: Point, edge: Edge) -> Option<usize> {
        let index = self.len();
        let cost_m = self.cost_m(edge.parent) + edge.length_m;
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
        let lane = self.len() % LANES;
        if self.links.push(links).is_err() || (lane == 0 && self.chunks.push(Chunk::EMPTY).is_err())
        {
            return false;
        }
        if let Some(chunk) = self.chunks.last_mut() {
            chunk.x_m[lane] = point_body.x;
            chunk.y_m[lane] = point_body.y;
            chunk.cost_m[lane] = cost_m;
        }
        true
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

    /// Moves a node with its subtree to a new parent, and updates the costs of the
    /// subtree.
    ///
    /// The new parent must not be in the subtree; a parent that makes the node cheaper
    /// never is.
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

    /// Recomputes the costs of a node's subtree, parents first. The walk follows the
    /// links, so it needs neither a stack nor recursion.
    fn refresh(&mut self, top: usize) {
        let mut at = top;
        loop {
            let links = self.links[at];
            self.set_cost_m(at, self.cost_m(links.parent as usize) + links.edge_m);
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

/// The chunk with the least of all numbers, and that number; of equals the
/// first. Infinity in chunk 0 when there is none.
///
/// The least of each chunk first: a single running minimum would be a chain of
/// dependent comparisons.
#[inline]
pub(crate) fn least_chunk(chunks: impl Iterator<Item = [f64; LANES]>) -> (usize, f64) {
    let less = |a: f64, b: f64| if a < b { a } else { b };
    let (mut at, mut least) = (0, f64::INFINITY);
    for (index, [a, b, c, d, e, f, g, h]) in chunks.enumerate() {
        let (ae, bf, cg, dh) = (less(a, e), less(b, f), less(c, g), less(d, h));
        let own = less(less(ae, cg), less(bf, dh));
        let is_less = own < least;
        at = if is_less { index } else { at };
        least = if is_less { own } else { least };
    }
    (at, least)
}

/// The first place of a number in a chunk; the first of all when it is not there.
pub(crate) fn lane_of(chunk: &[f64; LANES], number: f64) -> usize {
    let lane = chunk.iter().position(|&other| other == number);
    lane.unwrap_or(0)
}
