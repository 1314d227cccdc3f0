//! The buckets against a scan of all nodes, ties included.

use proptest::prelude::*;
use vehicle::Point;

use super::{Buckets, Reach, Spread, Via};

/// Places and costs are multiples of this, m: many distances, and sums of a distance and a
/// cost, are then equal to the last bit.
const STEP_M: f64 = 0.5;

#[derive(Debug, Clone, Copy)]
struct Node {
    point: Point,
    cost_m: f64,
}

fn lattice() -> impl Strategy<Value = Point> {
    // Also outside the regions, which are 15 m by 6 m and by 15 m.
    (-4i32..40, -17i32..17)
        .prop_map(|(x, y)| Point::new(f64::from(x) * STEP_M, f64::from(y) * STEP_M))
}

fn anywhere() -> impl Strategy<Value = Point> {
    (-1.0..16.0, -8.0..8.0).prop_map(|(x, y)| Point::new(x, y))
}

fn nodes() -> impl Strategy<Value = Vec<Node>> {
    let node = (prop_oneof![lattice(), anywhere()], 0u32..60);
    let node = node.prop_map(|(point, cost)| Node {
        point,
        cost_m: f64::from(cost) * STEP_M,
    });
    prop::collection::vec(node, 1..300)
}

fn square(node: &Node, from: Point) -> f64 {
    let (dx_m, dy_m) = (node.point.x - from.x, node.point.y - from.y);
    dx_m * dx_m + dy_m * dy_m
}

/// The buckets of a region for so many nodes, and each node's slot.
fn filled(nodes: &[Node], wanted: u32) -> (Buckets, Vec<u16>) {
    let mut buckets = Buckets::new();
    // With 1,920 or more nodes the square one has as many buckets as a mask has bits.
    let half_m = if wanted.is_multiple_of(2) { 3.0 } else { 7.5 };
    buckets.restart(&Spread {
        low: Point::new(0.0, -half_m),
        high: Point::new(15.0, half_m),
        nodes: wanted,
    });
    let slots = nodes.iter().enumerate().map(|(index, node)| {
        let slot = buckets.push(index as u16, node.point, node.cost_m);
        slot.expect("fewer nodes than there may be")
    });
    let slots = slots.collect();
    (buckets, slots)
}

/// The nodes that pass a test of cost and distance, m, within a radius.
fn passing(
    (nodes, from, radius_m): (&[Node], Point, f64),
    passes: impl Fn(f64, f64) -> bool,
) -> Vec<(u16, u64)> {
    let all = nodes.iter().enumerate().map(|(index, node)| {
        let square = square(node, from);
        (index as u16, square, node.cost_m)
    });
    all.filter(|(_, square, _)| *square <= radius_m * radius_m)
        .filter(|(_, square, cost_m)| passes(*cost_m, square.sqrt()))
        .map(|(index, square, _)| (index, square.to_bits()))
        .collect()
}

/// The same by the buckets.
fn found(
    (buckets, from, reach): (&mut Buckets, Point, Reach),
    passes: impl Fn(f64, f64) -> bool,
) -> Vec<(u16, u64)> {
    let mut all = Vec::new();
    buckets.measure(from);
    buckets.each_within(from, reach, |found| {
        if passes(found.cost_m, found.square.sqrt()) {
            all.push((found.index, found.square.to_bits()));
        }
    });
    all.sort_unstable();
    all
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1500, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_nearest_is_the_first_of_the_nearest_of_a_scan(
        nodes in nodes(),
        wanted in 0u32..2500,
        from in prop_oneof![lattice(), anywhere()],
    ) {
        let (mut buckets, _) = filled(&nodes, wanted);
        let scanned = nodes.iter().map(|node| square(node, from)).enumerate();
        let scanned = scanned.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        let (index, square) = buckets.nearest(from);
        prop_assert_eq!((index, square.to_bits()), (scanned.0, scanned.1.to_bits()));
    }

    #[test]
    fn parents_children_and_all_are_those_of_a_scan(
        (mut nodes, wanted) in (nodes(), 0u32..2500),
        from in prop_oneof![lattice(), anywhere()],
        (radius_m, at_m) in (prop_oneof![Just(1.5), Just(3.0), 0.1..30.0], 0u32..80),
        lowered in prop::collection::vec((any::<prop::sample::Index>(), 0u32..60), 0..50),
    ) {
        let (mut buckets, slots) = filled(&nodes, wanted);
        let at_m = f64::from(at_m) * STEP_M;
        for round in 0..2 {
            let scan = (&nodes[..], from, radius_m);
            let mut via: Vec<(f64, u16)> = Vec::new();
            for (index, node) in nodes.iter().enumerate() {
                let square = square(node, from);
                let cost_m = node.cost_m + square.sqrt();
                if square <= radius_m * radius_m && cost_m < at_m {
                    via.push((cost_m, index as u16));
                }
            }
            via.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let mut found_via = Vec::new();
            let mut after = None;
            buckets.measure(from);
            let limit = Via::unnamed(at_m);
            while let Some(next) = buckets.cheapest_via(from, radius_m, limit, after) {
                found_via.push((next.cost_m, next.index as u16));
                after = Some(next);
            }
            prop_assert_eq!(&found_via, &via);
            // Whichever of them is known, the first is found.
            for &(cost_m, index) in &via {
                let known = Via { cost_m, index: f64::from(index) };
                let found = buckets.cheapest_via(from, radius_m, known, None);
                let found = found.map(|found| (found.cost_m, found.index as u16));
                prop_assert_eq!(found.as_ref(), via.first());
            }
            let cheaper = |cost_m: f64, distance_m: f64| at_m + distance_m < cost_m;
            let reach = Reach::of_children(at_m, radius_m);
            prop_assert_eq!(found((&mut buckets, from, reach), cheaper), passing(scan, cheaper));
            let all = |_: f64, _: f64| true;
            let reach = Reach::of_all(radius_m);
            prop_assert_eq!(found((&mut buckets, from, reach), all), passing(scan, all));
            if round == 0 {
                for (node, cost) in &lowered {
                    let node = node.index(nodes.len());
                    let cost_m = nodes[node].cost_m.min(f64::from(*cost) * STEP_M);
                    nodes[node].cost_m = cost_m;
                    buckets.lower(slots[node], cost_m);
                }
            }
        }
    }
}

#[test]
fn a_place_that_is_no_number_has_the_first_node_infinitely_far_away() {
    let node = Node {
        point: Point::new(1.0, 1.0),
        cost_m: 0.0,
    };
    for wanted in [0, 2000] {
        let (mut buckets, _) = filled(&[node, node], wanted);
        let nearest = buckets.nearest(Point::new(f64::NAN, 0.0));
        assert_eq!(nearest, (0, f64::INFINITY));
    }
}

#[test]
fn a_node_added_after_a_measurement_is_found() {
    let near = Point::new(1.0, 1.0);
    let node = Node {
        point: Point::new(14.0, 2.0),
        cost_m: 0.0,
    };
    for wanted in [0, 200, 2000] {
        let (mut buckets, _) = filled(&[node], wanted);
        let all = |_: f64, _: f64| true;
        let reach = Reach::of_all(1.0);
        assert_eq!(found((&mut buckets, near, reach), all), []);
        buckets.push(1, near, 3.0).expect("room");
        assert_eq!(found((&mut buckets, near, reach), all), [(1, 0)]);
    }
}

#[test]
fn as_many_nodes_as_a_tree_has_fit_however_they_lie() {
    let most = shm_config::settings::planner::NODES_MAX;
    for spread_m in [0.0, 0.01, 20.0] {
        let nodes: Vec<Node> = (0..most)
            .map(|index| Node {
                point: Point::new(spread_m * (index % 97) as f64 / 97.0, 0.0),
                cost_m: 0.0,
            })
            .collect();
        let (mut buckets, slots) = filled(&nodes, most as u32);
        assert_eq!(slots.len(), most);
        assert_eq!(buckets.nearest(Point::origin()), (0, 0.0));
    }
}
