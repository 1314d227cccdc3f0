//! RRT* with buckets against RRT* that scans all nodes, on samples of a lattice: many
//! distances and many costs are equal, so that the order of equals counts.

use proptest::prelude::*;
use shm_config::message::Observation;
use vehicle::Point;

use super::{SAME_M, Search};
use crate::PlannerConfig;
use crate::grid::Grid;
use crate::sampler::Region;

/// A node, its parent, and the length of the edge to it, m.
#[derive(Debug, Clone, Copy)]
struct Plain {
    point: Point,
    parent: usize,
    edge_m: f64,
}

fn square(a: Point, b: Point) -> f64 {
    let (dx_m, dy_m) = (a.x - b.x, a.y - b.y);
    dx_m * dx_m + dy_m * dy_m
}

fn distance_m(a: Point, b: Point) -> f64 {
    square(a, b).sqrt()
}

/// The edges from the start on, summed in that order.
fn cost_m(tree: &[Plain], index: usize) -> f64 {
    match index {
        0 => 0.0,
        _ => cost_m(tree, tree[index].parent) + tree[index].edge_m,
    }
}

/// One iteration that looks at all nodes in the order they were made.
fn extend_plainly(
    tree: &mut Vec<Plain>,
    grid: &Grid,
    (config, area): (&PlannerConfig, f64),
    sample: Point,
) {
    let far = |index: &usize| square(tree[*index].point, sample);
    let nearest = (0..tree.len())
        .min_by(|a, b| far(a).total_cmp(&far(b)))
        .unwrap();
    let (from, apart_m) = (tree[nearest].point, far(&nearest).sqrt());
    if apart_m < SAME_M {
        return;
    }
    let point = match apart_m > config.step_m {
        true => from + (sample - from) * (config.step_m / apart_m),
        false => sample,
    };
    insert_plainly(tree, grid, (config, area), (nearest, point));
}

/// Adds a point that is reached from a node.
fn insert_plainly(
    tree: &mut Vec<Plain>,
    grid: &Grid,
    (config, area): (&PlannerConfig, f64),
    (from, point): (usize, Point),
) {
    if !grid.is_segment_free(tree[from].point, point) {
        return;
    }
    let thin = |nodes: f64| (nodes.ln() / nodes).sqrt();
    let radius_m = config.rewire_radius_m;
    let radius_m = match tree.len() > config.shrink_after as usize {
        true => {
            radius_m.min(thin(tree.len() as f64) * 2.0 * (1.5 * area / std::f64::consts::PI).sqrt())
        }
        false => radius_m,
    };
    let near: Vec<usize> = (0..tree.len())
        .filter(|&index| square(tree[index].point, point) <= radius_m.powi(2))
        .collect();
    let via_m = |index: usize| cost_m(tree, index) + distance_m(tree[index].point, point);
    let parent = near
        .iter()
        .copied()
        .filter(|&index| via_m(index) < via_m(from))
        .filter(|&index| grid.is_segment_free(tree[index].point, point))
        .min_by(|&a, &b| via_m(a).total_cmp(&via_m(b)))
        .unwrap_or(from);
    tree.push(Plain {
        point,
        parent,
        edge_m: distance_m(tree[parent].point, point),
    });
    let new = tree.len() - 1;
    for other in near {
        let edge_m = distance_m(tree[other].point, point);
        if cost_m(tree, new) + edge_m < cost_m(tree, other)
            && grid.is_segment_free(point, tree[other].point)
        {
            (tree[other].parent, tree[other].edge_m) = (new, edge_m);
        }
    }
}

/// A road 10 m wide with some returns of a scanner with 64 beams.
fn scene(returns: &[(usize, f32)]) -> Observation {
    let mut observation = Observation {
        beam_count: 64,
        lidar_max_m: 50.0,
        ..Observation::default()
    };
    observation.ranges_m.fill(50.0);
    for (beam, range_m) in returns {
        observation.ranges_m[*beam] = *range_m;
    }
    (observation.road.left_m, observation.road.right_m) = (5.0, 5.0);
    observation
}

/// Sometimes a node to begin at.
fn from() -> impl Strategy<Value = Option<prop::sample::Index>> {
    prop::option::weighted(0.2, any::<prop::sample::Index>())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_tree_on_a_lattice_is_that_of_a_scan(
        samples in prop::collection::vec((0i32..40, -8i32..=8, from()), 1..250),
        returns in prop::collection::vec((0usize..64, 1.0f32..20.0), 0..12),
        (step_m, rewire_radius_m, shrink_after) in (
            prop::sample::select(vec![0.5, 1.0, 2.0, 40.0]),
            prop::sample::select(vec![0.5, 1.5, 3.0, 40.0]),
            prop::sample::select(vec![3, 30, 200]),
        ),
        iterations in 1u32..3000,
    ) {
        let config = PlannerConfig {
            step_m,
            rewire_radius_m,
            shrink_after,
            iterations,
            ..PlannerConfig::default()
        };
        let mut grid = Grid::new(&config);
        grid.fill(&scene(&returns));
        let mut search = Box::new(Search::empty());
        let region = Region { x_max_m: 15.0, right_m: -4.0, left_m: 4.0 };
        search.restart(&region, &config);
        let mut plain = vec![Plain { point: Point::origin(), parent: 0, edge_m: 0.0 }];
        let terms = (&config, 15.0 * 8.0);
        for (x, y, from) in samples {
            let sample = Point::new(f64::from(x) * 0.5, f64::from(y) * 0.5);
            match from.map(|from| from.index(plain.len())) {
                None => {
                    search.extend(&grid, &config, sample);
                    extend_plainly(&mut plain, &grid, terms, sample);
                }
                // As from a remembered path: from any node, however far away.
                Some(from) => {
                    search.insert(&grid, &config, from, sample);
                    insert_plainly(&mut plain, &grid, terms, (from, sample));
                }
            }
        }
        prop_assert_eq!(search.tree.len(), plain.len());
        for (index, node) in search.tree.nodes().enumerate() {
            let parent = (index > 0).then_some(plain[index].parent);
            prop_assert_eq!(node.point_body, plain[index].point, "node {}", index);
            prop_assert_eq!(node.parent, parent, "node {}", index);
            let cost_m = cost_m(&plain, index);
            prop_assert_eq!(node.cost_m.to_bits(), cost_m.to_bits(), "node {}", index);
        }
        let goal = Point::new(15.0, 0.0);
        let in_ball = |index: &usize| square(plain[*index].point, goal) <= 1.5 * 1.5;
        let cheapest = (0..plain.len())
            .filter(in_ball)
            .min_by(|&a, &b| cost_m(&plain, a).total_cmp(&cost_m(&plain, b)));
        prop_assert_eq!(search.reached(goal, 1.5), cheapest);
    }
}
