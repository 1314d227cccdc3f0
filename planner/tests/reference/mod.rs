//! The planner once more, slow and obvious: every cell asks every return, every
//! line asks every cell, every node asks every node, every cost is summed anew.
#![allow(dead_code)]

use planner::{Cell, Grid, PlannerConfig};
use proptest::prelude::*;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rand_xoshiro::{SplitMix64, Xoshiro256PlusPlus};
use shm_config::message::Observation;
use vehicle::{Point, Vehicle};

use crate::course::Dice;

/// Distances that differ by less are equal, m.
const EQUAL_M: f64 = 1e-9;
/// A line this near to a cell, in cells, touches it.
const TOUCH: f64 = 1e-9;

/// Occupied cells, `[row][column]`.
pub struct Dense {
    pub cell_m: f64,
    pub y_max_m: f64,
    pub cells: Vec<Vec<bool>>,
}

/// Edges of the corridor that holds the start, m: right, left.
pub fn corridor_m(config: &PlannerConfig, observation: &Observation) -> (f64, f64) {
    let (left_m, right_m) = (observation.road.left_m, observation.road.right_m);
    let (mut low_m, mut high_m) = (
        -right_m + config.lane_margin_m,
        left_m - config.lane_margin_m,
    );
    if low_m > high_m {
        (low_m, high_m) = ((left_m - right_m) / 2.0, (left_m - right_m) / 2.0);
    }
    let limit = |y_m: f64| y_m.max(-config.y_max_m).min(config.y_max_m);
    (
        limit(low_m).min(-config.cell_m),
        limit(high_m).max(config.cell_m),
    )
}

/// Middles of the cells that hold a return, m.
fn return_middles(config: &PlannerConfig, observation: &Observation) -> Vec<Point> {
    let count = observation.ranges().len();
    let mut middles = Vec::new();
    for (beam, &range_m) in observation.ranges().iter().enumerate() {
        if range_m >= observation.lidar_max_m {
            continue;
        }
        let angle_rad = if 2 * beam > count {
            -(std::f64::consts::TAU * (count - beam) as f64 / count as f64)
        } else {
            std::f64::consts::TAU * beam as f64 / count as f64
        };
        let (x_m, y_m) = (
            f64::from(range_m) * angle_rad.cos(),
            f64::from(range_m) * angle_rad.sin(),
        );
        let middle = |x_m: f64, y_m: f64, side: f64| {
            let across = (y_m.abs() / config.cell_m).floor() + 0.5;
            Point::new(
                ((x_m / config.cell_m).floor() + 0.5) * config.cell_m,
                side * across * config.cell_m,
            )
        };
        if beam == 0 || 2 * beam == count || range_m == 0.0 {
            middles.push(middle(x_m, 0.0, 1.0));
            middles.push(middle(x_m, 0.0, -1.0));
        } else {
            middles.push(middle(x_m, y_m, y_m.signum()));
        }
    }
    middles
}

impl Dense {
    pub fn new(config: &PlannerConfig, observation: &Observation) -> Self {
        let columns = (config.x_max_m / config.cell_m).round() as usize;
        let half_rows = (config.y_max_m / config.cell_m).round() as usize;
        let (right_m, left_m) = corridor_m(config, observation);
        let returns: Vec<(Point, f64)> = return_middles(config, observation)
            .into_iter()
            .map(|middle| {
                let start_m = [0.5, -0.5].map(|row| {
                    (middle - Point::new(0.5 * config.cell_m, row * config.cell_m)).norm()
                });
                (middle, start_m[0].min(start_m[1]))
            })
            .collect();
        let middle = |row: usize, column: usize| {
            Point::new(
                (column as f64 + 0.5) * config.cell_m,
                (row as f64 + 0.5 - half_rows as f64) * config.cell_m,
            )
        };
        let car = Vehicle::default();
        let sight = observation.fan().sight();
        // Ahead of the bumper, where the front of the body would be beside the row.
        let beside = (car.width_m / 2.0 / config.cell_m - 1.0).max(0.0) as usize;
        let unseen = |row: usize, column: usize| {
            let last = 2 * half_rows - 1;
            let rows = row.saturating_sub(beside)..=(row + beside).min(last);
            column as f64 * config.cell_m >= car.length_m / 2.0
                && rows
                    .into_iter()
                    .any(|row| !sight.covers(middle(row, column), car.width_m))
        };
        let occupied = |row: usize, column: usize| {
            let middle = middle(row, column);
            middle.y < right_m
                || middle.y > left_m
                || unseen(row, column)
                || returns.iter().any(|(from, start_m)| {
                    let distance_m = (middle - from).norm();
                    distance_m <= config.inflation_m + EQUAL_M && distance_m < start_m - EQUAL_M
                })
        };
        Self {
            cell_m: config.cell_m,
            y_max_m: half_rows as f64 * config.cell_m,
            cells: (0..2 * half_rows)
                .map(|row| (0..columns).map(|column| occupied(row, column)).collect())
                .collect(),
        }
    }

    /// The cells of a grid as they are, for scenes too large to be asked anew.
    pub fn of(grid: &Grid) -> Self {
        let row = |row| {
            (0..grid.columns())
                .map(|column| grid.is_occupied(Cell { column, row }))
                .collect()
        };
        Self {
            cell_m: grid.cell_m(),
            y_max_m: grid.y_max_m(),
            cells: (0..grid.rows()).map(row).collect(),
        }
    }

    /// Whether no occupied cell has a point in common with the line: each cell's
    /// square is cut with the line (the slab method).
    pub fn is_free(&self, from_body: Point, to_body: Point) -> bool {
        let half_rows = (self.cells.len() / 2) as f64;
        let per_m = 1.0 / self.cell_m;
        let from = [from_body.x * per_m, from_body.y * per_m + half_rows];
        let to = [to_body.x * per_m, to_body.y * per_m + half_rows];
        let size = [self.cells[0].len() as f64, self.cells.len() as f64];
        let inside = |point: [f64; 2]| (0..2).all(|axis| (0.0..=size[axis]).contains(&point[axis]));
        if !inside(from) || !inside(to) {
            return false;
        }
        let span = |axis: usize| {
            let (low, high) = (from[axis].min(to[axis]), from[axis].max(to[axis]));
            let last = size[axis] as usize - 1;
            ((low - 2.0).max(0.0) as usize)..=((high + 2.0) as usize).min(last)
        };
        span(1).all(|row| {
            span(0).all(|column| !self.cells[row][column] || !touches(from, to, [column, row]))
        })
    }
}

fn touches(from: [f64; 2], to: [f64; 2], cell: [usize; 2]) -> bool {
    let (mut enter, mut leave) = (0.0f64, 1.0f64);
    for axis in 0..2 {
        let (low, high) = (cell[axis] as f64 - TOUCH, cell[axis] as f64 + 1.0 + TOUCH);
        let slope = to[axis] - from[axis];
        if slope == 0.0 {
            if from[axis] < low || from[axis] > high {
                return false;
            }
            continue;
        }
        let (a, b) = ((low - from[axis]) / slope, (high - from[axis]) / slope);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    enter <= leave
}

/// A node of the slow tree.
#[derive(Debug, Clone, Copy)]
pub struct SlowNode {
    pub point: Point,
    pub parent: Option<usize>,
}

/// Cost of a node, m: the edges from the start to it, summed in that order.
pub fn cost_m(tree: &[SlowNode], index: usize) -> f64 {
    match tree[index].parent {
        None => 0.0,
        Some(parent) => {
            let edge = tree[index].point - tree[parent].point;
            cost_m(tree, parent) + (edge.x * edge.x + edge.y * edge.y).sqrt()
        }
    }
}

fn distance_m(a: Point, b: Point) -> f64 {
    let edge = a - b;
    (edge.x * edge.x + edge.y * edge.y).sqrt()
}

/// RRT* by the book, on the dense grid, with the planner's stream of samples.
pub fn slow_tree(
    config: &PlannerConfig,
    observation: &Observation,
    grid: &Dense,
    goal: Point,
) -> Vec<SlowNode> {
    let mut stream = stream(config.seed, observation);
    let mut unit = || (stream.next_u64() >> 11) as f64 / 9_007_199_254_740_992.0;
    let (right_m, left_m) = corridor_m(config, observation);
    let mut tree = vec![SlowNode {
        point: Point::origin(),
        parent: None,
    }];
    for _ in 0..config.iterations {
        let sample = if config.goal_bias > 0.0 && unit() < config.goal_bias {
            goal
        } else {
            let x_m = unit() * goal.x;
            Point::new(x_m, right_m + unit() * (left_m - right_m))
        };
        let nearest = (0..tree.len())
            .min_by(|&a, &b| {
                let square = |index: usize| {
                    let edge = tree[index].point - sample;
                    edge.x * edge.x + edge.y * edge.y
                };
                square(a).total_cmp(&square(b))
            })
            .unwrap();
        let from = tree[nearest].point;
        let apart_m = distance_m(from, sample);
        if apart_m < 1e-6 {
            continue;
        }
        let point = if apart_m > config.step_m {
            from + (sample - from) * (config.step_m / apart_m)
        } else {
            sample
        };
        if !grid.is_free(from, point) {
            continue;
        }
        let radius_m = radius_m(config, tree.len(), goal.x * (left_m - right_m));
        let square_limit = radius_m * radius_m;
        let near: Vec<usize> = (0..tree.len())
            .filter(|&index| {
                let edge = tree[index].point - point;
                edge.x * edge.x + edge.y * edge.y <= square_limit
            })
            .collect();
        let via = |tree: &[SlowNode], index: usize| {
            cost_m(tree, index) + distance_m(tree[index].point, point)
        };
        let nearest_via = via(&tree, nearest);
        let parent = near
            .iter()
            .copied()
            .filter(|&index| via(&tree, index) < nearest_via)
            .filter(|&index| grid.is_free(tree[index].point, point))
            .min_by(|&a, &b| via(&tree, a).total_cmp(&via(&tree, b)))
            .unwrap_or(nearest);
        tree.push(SlowNode {
            point,
            parent: Some(parent),
        });
        let index = tree.len() - 1;
        for other in near {
            let through = cost_m(&tree, index) + distance_m(tree[other].point, point);
            if through < cost_m(&tree, other) && grid.is_free(point, tree[other].point) {
                tree[other].parent = Some(index);
            }
        }
    }
    tree
}

/// The radius of `planner.rewire_radius_m` for a tree of some nodes, in a region of some m².
fn radius_m(config: &PlannerConfig, nodes: usize, area: f64) -> f64 {
    let thin = |nodes: f64| (nodes.ln() / nodes).sqrt();
    let asked_m = 2.0 * (1.5 * area / std::f64::consts::PI).sqrt();
    match nodes > config.shrink_after as usize {
        true => config.rewire_radius_m.min(asked_m * thin(nodes as f64)),
        false => config.rewire_radius_m,
    }
}

/// The documented stream: SplitMix64 over seed, episode and tick.
fn stream(seed: u64, observation: &Observation) -> Xoshiro256PlusPlus {
    let split = |number| SplitMix64::seed_from_u64(number).next_u64();
    let with_episode = split(split(seed) ^ u64::from(observation.header.episode));
    Xoshiro256PlusPlus::seed_from_u64(split(with_episode ^ observation.header.tick))
}

/// Planners of all shapes, small enough to be asked cell by cell.
pub fn small_config() -> impl Strategy<Value = PlannerConfig> {
    (
        prop::sample::select(vec![0.1, 0.125, 0.2, 0.25]),
        (5u32..12, 1u32..6),
        (0.0..1.5, 0.0..1.5),
        (1u32..160, 0.3..3.0, 0.3..4.0),
        (
            prop::sample::select(vec![0.0, 0.0, 0.2]),
            3.0..12.0,
            any::<u64>(),
            prop::sample::select(vec![3, 40, 200]),
        ),
    )
        .prop_map(
            |(cell_m, (x_max_m, y_max_m), (inflation_m, lane_margin_m), tree, rest)| {
                PlannerConfig {
                    cell_m,
                    x_max_m: f64::from(x_max_m),
                    y_max_m: f64::from(y_max_m),
                    inflation_m,
                    lane_margin_m,
                    iterations: tree.0,
                    step_m: tree.1,
                    rewire_radius_m: tree.2,
                    goal_bias: rest.0,
                    goal_distance_m: rest.1,
                    partial_min_m: 1.0,
                    seed: rest.2,
                    shrink_after: rest.3,
                    ..PlannerConfig::default()
                }
            },
        )
}

/// Anything that passes the door: any number of beams, returns anywhere, also
/// under the car, roads that the car is beside, checkpoints behind it.
pub fn wild_observation(seed: u64) -> Observation {
    let mut dice = Dice::new(seed);
    let beams = [0, 1, 2, 3, 16, 101, 240, 512][dice.below(8) as usize];
    let mut observation = Observation {
        beam_count: beams,
        lidar_max_m: 20.0,
        ..Observation::default()
    };
    observation.header.tick = dice.below(1 << 40);
    observation.header.episode = dice.below(1000) as u32;
    let crowd = dice.between(0.0, 0.3);
    let nearest_m = dice.between(0.0, 3.0);
    for range_m in &mut observation.ranges_m[..beams as usize] {
        *range_m = if dice.between(0.0, 1.0) < crowd {
            dice.between(nearest_m, 12.0) as f32
        } else {
            20.0
        };
    }
    observation.road.left_m = dice.between(-2.0, 9.0);
    observation.road.right_m = dice.between(-2.0, 9.0);
    observation.road.heading_rad = dice.between(-1.0, 1.0).powi(3) * 3.1;
    for checkpoint in &mut observation.checkpoints {
        checkpoint.x_body_m = dice.between(-20.0, 60.0);
        checkpoint.y_body_m = dice.between(-40.0, 40.0);
    }
    observation
}
