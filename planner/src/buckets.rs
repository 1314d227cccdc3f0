//! Where the nodes of a tree are: a grid of buckets over the region of the samples.
//!
//! Every answer is that of a scan of all nodes, to the last bit, ties included. A bucket
//! is left out only where no node of it can count: its nodes are inside its bounds, and
//! no cheaper and no dearer than two costs. What is worked out for the bounds rounds as
//! what is worked out for a node does, and each of these operations keeps the order of
//! what it is given; so a bound is never farther away than a node in it.

mod block;
mod lanes;

use heapless::Vec;
use shm_config::settings::planner::NODES_MAX;
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Point, Vector};

use block::{Block, Group};
pub(crate) use lanes::LANES;
use lanes::{least_of, less, mask, more, take_lowest};

/// Most buckets: 4,096 nodes are then 64 in each.
const BUCKETS_MAX: usize = 64;
const GROUPS_MAX: usize = BUCKETS_MAX / LANES;
/// A bucket's last block may hold a single node.
const BLOCKS_MAX: usize = NODES_MAX / LANES + BUCKETS_MAX;
/// Nodes for each bucket that a region is divided for. To pass over a bucket costs as much as
/// a few blocks, because the processor cannot foresee which are passed over: 15 and 60 are
/// slower at the paper's 200 iterations.
const NODES_PER_BUCKET: u32 = 30;
/// Stands for "no block" among indices.
const NONE: u16 = u16::MAX;
/// Added to a distance that a node of some cost may have, m. A cost is at most 6e5 m,
/// which rounds by 1e-10.
const SLACK_M: f64 = 1e-6;

const _: () = assert!(
    BLOCKS_MAX * LANES < NONE as usize,
    "a slot's index is a u16"
);
const _: () = assert!(BUCKETS_MAX <= 64, "a mask has a bit for each");

/// The rectangle that most nodes are in, and how many there will be.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Spread {
    pub(crate) low: Point,
    pub(crate) high: Point,
    pub(crate) nodes: u32,
}

impl Spread {
    /// Of nodes whose places are not known: all are in one bucket, in the order they were
    /// made.
    pub(crate) const UNKNOWN: Self = Self {
        low: Point::new(0.0, 0.0),
        high: Point::new(0.0, 0.0),
        nodes: 0,
    };
}

/// How far from a point a node may be, by its cost: a cost times this sign and a length, m,
/// and at most the radius.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reach {
    sign: f64,
    base_m: f64,
    radius_m: f64,
}

impl Reach {
    /// Of nodes through which the way may be at most this long, m.
    fn of_parents(limit_m: f64, radius_m: f64) -> Self {
        Self {
            sign: -1.0,
            base_m: limit_m + SLACK_M,
            radius_m,
        }
    }

    /// Of nodes that cost more by the way they have than from a node of this cost, m.
    pub(crate) fn of_children(cost_m: f64, radius_m: f64) -> Self {
        Self {
            sign: 1.0,
            base_m: SLACK_M - cost_m,
            radius_m,
        }
    }

    /// Of nodes of any cost.
    pub(crate) fn of_all(radius_m: f64) -> Self {
        Self {
            sign: 0.0,
            base_m: f64::INFINITY,
            radius_m,
        }
    }

    /// Squared, m². Within the radius exactly; the cost may be missed by the slack.
    #[inline(always)]
    fn square(&self, cost_m: f64) -> f64 {
        let reach_m = less(more(self.sign * cost_m + self.base_m, 0.0), self.radius_m);
        reach_m * reach_m
    }
}

/// A node that was found.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Found {
    pub(crate) index: u16,
    /// Its squared distance, m².
    pub(crate) square: f64,
    pub(crate) cost_m: f64,
}

/// The nearest node of those in each lane, of equals the first.
struct Nearest {
    squares: [f64; LANES],
    index: [f64; LANES],
}

impl Nearest {
    const NONE: Self = Self {
        squares: [f64::INFINITY; LANES],
        index: [f64::INFINITY; LANES],
    };
}

/// The way to a point through a node.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Via {
    /// Its length from the start, m.
    pub(crate) cost_m: f64,
    /// Of the node; -1 for none.
    pub(crate) index: f64,
}

impl Via {
    /// A limit, m: a way through no node, which comes before ways of its length through nodes.
    pub(crate) const fn unnamed(cost_m: f64) -> Self {
        Self {
            cost_m,
            index: -1.0,
        }
    }
}

/// The shortest way through the nodes in each lane, of equals the first.
struct Best {
    cost_m: [f64; LANES],
    index: [f64; LANES],
}

/// See the module's documentation.
#[derive(Debug)]
pub(crate) struct Buckets {
    low: Point,
    per_m: Vector,
    columns: usize,
    rows: usize,
    groups: Vec<Group, GROUPS_MAX>,
    blocks: Vec<Block, BLOCKS_MAX>,
    /// From where the buckets are measured; not a number when a node has been added since.
    measured: Point,
}

/// Equals no point, not even itself.
const UNMEASURED: Point = Point::new(f64::NAN, f64::NAN);

impl Buckets {
    pub(crate) const fn new() -> Self {
        Self {
            low: Point::new(0.0, 0.0),
            per_m: Vector::new(0.0, 0.0),
            columns: 0,
            rows: 0,
            groups: Vec::new(),
            blocks: Vec::new(),
            measured: UNMEASURED,
        }
    }

    /// Without nodes.
    pub(crate) fn restart(&mut self, spread: &Spread) {
        let size_m = spread.high - spread.low;
        let wanted = (spread.nodes / NODES_PER_BUCKET).clamp(1, BUCKETS_MAX as u32) as usize;
        let (columns, rows) = match size_m.x > 0.0 && size_m.y > 0.0 {
            true => {
                let rows = (wanted as f64 * size_m.y / size_m.x).sqrt().round();
                let rows = (rows as usize).clamp(1, wanted);
                (wanted / rows, rows)
            }
            false => (1, 1),
        };
        self.low = spread.low;
        self.per_m = match columns * rows > 1 {
            true => Vector::new(columns as f64 / size_m.x, rows as f64 / size_m.y),
            false => Vector::zeros(),
        };
        (self.columns, self.rows) = (columns, rows);
        self.measured = UNMEASURED;
        self.blocks.clear();
        self.groups.clear();
        for _ in 0..(columns * rows).div_ceil(LANES) {
            let _ = self.groups.push(Group::EMPTY);
        }
    }

    /// The bucket of a place; of one outside the region the nearest.
    #[inline(always)]
    fn bucket_at(&self, point_body: Point) -> usize {
        // The conversion of what is below 0 saturates.
        let at = |from_m: f64, per_m: f64, count: usize| ((from_m * per_m) as usize).min(count - 1);
        let column = at(point_body.x - self.low.x, self.per_m.x, self.columns);
        let row = at(point_body.y - self.low.y, self.per_m.y, self.rows);
        row * self.columns + column
    }

    /// Adds a node; its slot, or `None` when there are too many.
    pub(crate) fn push(&mut self, index: u16, point_body: Point, cost_m: f64) -> Option<u16> {
        self.measured = UNMEASURED;
        let bucket = self.bucket_at(point_body);
        let (group, lane) = (&mut self.groups[bucket / LANES], bucket % LANES);
        if usize::from(group.filled[lane]) == LANES {
            let block = Block {
                x_m: [f64::INFINITY; LANES],
                y_m: [f64::INFINITY; LANES],
                cost_m: [0.0; LANES],
                index: [f64::INFINITY; LANES],
                next: NONE,
                bucket: bucket as u16,
            };
            let at = self.blocks.len() as u16;
            self.blocks.push(block).ok()?;
            match group.first[lane] {
                NONE => group.first[lane] = at,
                _ => self.blocks[usize::from(group.last[lane])].next = at,
            }
            (group.last[lane], group.filled[lane]) = (at, 0);
        }
        let (at, free) = (
            usize::from(group.last[lane]),
            usize::from(group.filled[lane]),
        );
        group.filled[lane] += 1;
        group.low_x_m[lane] = less(point_body.x, group.low_x_m[lane]);
        group.high_x_m[lane] = more(point_body.x, group.high_x_m[lane]);
        group.low_y_m[lane] = less(point_body.y, group.low_y_m[lane]);
        group.high_y_m[lane] = more(point_body.y, group.high_y_m[lane]);
        group.least_m[lane] = less(cost_m, group.least_m[lane]);
        group.most_m[lane] = more(cost_m, group.most_m[lane]);
        let block = &mut self.blocks[at];
        (block.x_m[free], block.y_m[free]) = (point_body.x, point_body.y);
        (block.cost_m[free], block.index[free]) = (cost_m, f64::from(index));
        Some((at * LANES + free) as u16)
    }

    /// Notes the new cost of a node, at most its old one, m.
    pub(crate) fn lower(&mut self, slot: u16, cost_m: f64) {
        let (at, lane) = (usize::from(slot) / LANES, usize::from(slot) % LANES);
        let block = &mut self.blocks[at];
        block.cost_m[lane] = cost_m;
        let bucket = usize::from(block.bucket);
        let least_m = &mut self.groups[bucket / LANES].least_m[bucket % LANES];
        *least_m = less(cost_m, *least_m);
    }

    /// Writes the squared distance of each node to a point, m², into the beginning of
    /// `squares`, in the order they were made, of nodes of [`Spread::UNKNOWN`].
    pub(crate) fn write_squares(&self, point_body: Point, squares: &mut [[f64; LANES]]) {
        for (squares, block) in squares.iter_mut().zip(&self.blocks) {
            *squares = block.squares(point_body);
        }
    }

    /// Measures how far a point is from each bucket; does nothing for the point that was measured
    /// last if no node was added since. A sample near the tree is measured for its nearest node,
    /// and is then the point for which a parent is chosen.
    #[inline(always)]
    pub(crate) fn measure(&mut self, point_body: Point) {
        if point_body == self.measured {
            return;
        }
        self.measured = point_body;
        for group in &mut self.groups {
            group.measure(point_body);
        }
    }

    /// A bit for each bucket for which something holds. One loop then visits the buckets of all
    /// groups; of a loop in each group the processor would not foresee the end.
    #[inline(always)]
    fn those(&self, holds: impl Fn(&Group, usize) -> bool) -> u64 {
        let mut bits = 0;
        for (at, group) in self.groups.iter().enumerate() {
            bits |= mask(core::array::from_fn(|lane| holds(group, lane))) << (at * LANES);
        }
        bits
    }

    /// The node nearest to a point and its squared distance, m²; of equals the first.
    #[inline(always)]
    pub(crate) fn nearest(&mut self, point_body: Point) -> (usize, f64) {
        self.measure(point_body);
        let mut own = self.bucket_at(point_body);
        if self.groups[own / LANES].first[own % LANES] == NONE {
            own = self.least_bucket();
        }
        let mut best = Nearest::NONE;
        self.nearest_in(own, point_body, &mut best);
        let mut least = least_of(&best.squares);
        for group in 0..self.groups.len() {
            let squares = &self.groups[group].squares;
            let mut near = mask(core::array::from_fn(|lane| squares[lane] <= least));
            while let Some(lane) = take_lowest(&mut near) {
                let bucket = group * LANES + lane;
                if bucket != own {
                    self.nearest_in(bucket, point_body, &mut best);
                    least = least_of(&best.squares);
                }
            }
        }
        // A place that is not a number is as far from the first node as from all.
        let first = |lane| match best.squares[lane] == least && least < f64::INFINITY {
            true => best.index[lane],
            false => f64::INFINITY,
        };
        let index = least_of(&core::array::from_fn(first));
        match index < f64::INFINITY {
            true => (index as usize, least),
            false => (0, f64::INFINITY),
        }
    }

    /// The bucket nearest to the point that was measured.
    fn least_bucket(&self) -> usize {
        let squares = self.groups.iter().flat_map(|group| group.squares);
        let start = (0, f64::INFINITY);
        let least = squares.enumerate().fold(start, |least, (at, square)| {
            if square < least.1 {
                (at, square)
            } else {
                least
            }
        });
        least.0
    }

    // Other forms of this loop did not become vector instructions.
    #[allow(clippy::needless_range_loop)]
    #[inline(always)]
    fn nearest_in(&self, bucket: usize, point_body: Point, best: &mut Nearest) {
        let mut at = self.groups[bucket / LANES].first[bucket % LANES];
        while let Some(block) = self.blocks.get(usize::from(at)) {
            let squares = block.squares(point_body);
            for lane in 0..LANES {
                let (square, index) = (squares[lane], block.index[lane]);
                let is_first = square == best.squares[lane] && index < best.index[lane];
                let is_nearer = (square < best.squares[lane]) | is_first;
                best.squares[lane] = if is_nearer {
                    square
                } else {
                    best.squares[lane]
                };
                best.index[lane] = if is_nearer { index } else { best.index[lane] };
            }
            at = block.next;
        }
    }

    /// The first way, by length and then by index, of the known one, if it goes through a node,
    /// and of those through nodes within a radius, m, to the point that was measured. A way that
    /// is given as `after`, and all before it, do not count; then the known one is a limit.
    #[inline(always)]
    pub(crate) fn cheapest_via(
        &self,
        point_body: Point,
        radius_m: f64,
        known: Via,
        after: Option<Via>,
    ) -> Option<Via> {
        debug_assert!(
            after.is_none() || known.index < 0.0,
            "found again and again"
        );
        let after = after.unwrap_or(Via {
            cost_m: f64::NEG_INFINITY,
            index: 0.0,
        });
        let reach = Reach::of_parents(known.cost_m, radius_m);
        let mut best = Best {
            cost_m: [known.cost_m; LANES],
            index: [known.index; LANES],
        };
        let mut near =
            self.those(|group, lane| group.squares[lane] <= reach.square(group.least_m[lane]));
        while let Some(bucket) = take_lowest(&mut near) {
            let mut at = self.groups[bucket / LANES].first[bucket % LANES];
            while let Some(block) = self.blocks.get(usize::from(at)) {
                let squares = block.squares(point_body);
                let is_near = |lane: usize| squares[lane] <= reach.square(block.cost_m[lane]);
                if mask(core::array::from_fn(is_near)) != 0 {
                    best.take(block, squares, radius_m * radius_m, &after);
                }
                at = block.next;
            }
        }
        let cost_m = least_of(&best.cost_m);
        let first = |lane| match best.cost_m[lane] == cost_m {
            true => best.index[lane],
            false => f64::INFINITY,
        };
        let index = least_of(&core::array::from_fn(first));
        (index >= 0.0).then_some(Via { cost_m, index })
    }

    /// Calls a function with each node within reach of the point that was measured, and
    /// with some a little farther away by their costs, in no particular order.
    #[inline(always)]
    pub(crate) fn each_within(
        &mut self,
        point_body: Point,
        reach: Reach,
        mut found: impl FnMut(Found),
    ) {
        let mut near =
            self.those(|group, lane| group.squares[lane] <= reach.square(group.most_m[lane]));
        while let Some(bucket) = take_lowest(&mut near) {
            let (group, lane) = (&mut self.groups[bucket / LANES], bucket % LANES);
            let first = group.first[lane];
            group.most_m[lane] = each_in(&self.blocks, first, point_body, &reach, &mut found);
        }
    }
}

impl Best {
    /// Takes the nodes of a block in, at these squared distances, m².
    #[inline(always)]
    fn take(&mut self, block: &Block, squares: [f64; LANES], limit: f64, after: &Via) {
        // One simple loop after the other: of a single one the compiler may make no vectors.
        let mut costs_m = squares.map(f64::sqrt);
        for (cost_m, from_m) in costs_m.iter_mut().zip(&block.cost_m) {
            *cost_m += from_m;
        }
        let mut better = [false; LANES];
        for lane in 0..LANES {
            let (cost_m, index) = (costs_m[lane], block.index[lane]);
            let is_less = (cost_m < self.cost_m[lane])
                | ((cost_m == self.cost_m[lane]) & (index < self.index[lane]));
            let is_after =
                (cost_m > after.cost_m) | ((cost_m == after.cost_m) & (index > after.index));
            better[lane] = is_less & is_after & (squares[lane] <= limit);
        }
        for lane in 0..LANES {
            self.cost_m[lane] = if better[lane] {
                costs_m[lane]
            } else {
                self.cost_m[lane]
            };
            self.index[lane] = if better[lane] {
                block.index[lane]
            } else {
                self.index[lane]
            };
        }
    }
}

/// Calls a function with each node of a bucket within reach; the greatest cost of all its
/// nodes, m.
#[inline(always)]
fn each_in(
    blocks: &[Block],
    first: u16,
    point_body: Point,
    reach: &Reach,
    found: &mut impl FnMut(Found),
) -> f64 {
    let mut most_m = [f64::NEG_INFINITY; LANES];
    let mut at = first;
    while let Some(block) = blocks.get(usize::from(at)) {
        let squares = block.squares(point_body);
        for (most_m, &cost_m) in most_m.iter_mut().zip(&block.cost_m) {
            *most_m = more(cost_m, *most_m);
        }
        let is_near = |lane: usize| squares[lane] <= reach.square(block.cost_m[lane]);
        let mut near = mask(core::array::from_fn(is_near));
        while let Some(lane) = take_lowest(&mut near) {
            found(Found {
                index: block.index[lane] as u16,
                square: squares[lane],
                cost_m: block.cost_m[lane],
            });
        }
        at = block.next;
    }
    most_m.into_iter().fold(f64::NEG_INFINITY, more)
}

#[cfg(test)]
mod tests;
