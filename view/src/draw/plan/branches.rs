//! The tree of a plan: edges and nodes by cost-to-come.

use planner::{Dubins, Kinodynamic, Planner, PoseNode, Tree};
use svg::node::element::{Group, Path};
use vehicle::Point;

use super::figure::disc;
use super::view::View;
use crate::draw::palette;

/// Colours of the tree: edges of nearly the same cost share one path.
const SHADES: usize = 24;
/// Curves are drawn as chords of this length, m: in the car's tightest turn, of
/// 2.9 m, they leave the arc by 3 mm.
const CHORD_M: f64 = 0.25;

/// A node and the way to it.
pub(super) struct Branch {
    node_body: Point,
    /// From the node before it to this one; empty at the start.
    way_body: Vec<Point>,
    cost_m: f64,
}

/// The tree that the last plan left; none of a method without one.
pub(super) fn of(planner: &Planner) -> Option<Vec<Branch>> {
    match planner {
        Planner::Kinodynamic(planner) => Some(curved(planner)),
        planner => planner.tree().map(straight),
    }
}

fn straight(tree: &Tree) -> Vec<Branch> {
    let branch = |node: planner::Node| {
        let parent = node.parent.and_then(|index| tree.node(index));
        Branch {
            node_body: node.point_body,
            way_body: parent.map_or(vec![], |parent| vec![parent.point_body, node.point_body]),
            cost_m: node.cost_m,
        }
    };
    tree.nodes().map(branch).collect()
}

fn curved(planner: &Kinodynamic) -> Vec<Branch> {
    let nodes: Vec<PoseNode> = planner.nodes().collect();
    let way = |node: &PoseNode, parent: &PoseNode| {
        let (from, to) = (parent.body_from_node, node.body_from_node);
        // The same poses give the same curve as the planner had.
        let curve = Dubins::shortest(&from, &to, planner.radius_m());
        let length_m = curve.length_m();
        let chords = (length_m / CHORD_M).ceil().max(1.0) as usize;
        let at = |k| curve.at(&from, length_m * k as f64 / chords as f64);
        let places = (0..=chords).map(|k| at(k).translation.vector.into());
        places.collect()
    };
    let branch = |node: &PoseNode| {
        let parent = node.parent.and_then(|index| nodes.get(index));
        Branch {
            node_body: node.body_from_node.translation.vector.into(),
            way_body: parent.map_or(vec![], |parent| way(node, parent)),
            cost_m: node.cost_m,
        }
    };
    nodes.iter().map(branch).collect()
}

/// The cost of the dearest node, m.
pub(super) fn greatest_cost_m(branches: &[Branch]) -> f64 {
    let costs = branches.iter().map(|branch| branch.cost_m);
    costs.fold(f64::MIN_POSITIVE, f64::max)
}

/// All edges, then all nodes.
pub(super) fn draw(view: &View, branches: &[Branch], greatest_m: f64) -> Group {
    let mut shades = vec![String::new(); SHADES];
    let mut nodes = Group::new();
    for branch in branches {
        let share = branch.cost_m / greatest_m;
        let shade = ((share * SHADES as f64) as usize).min(SHADES - 1);
        shades[shade] += &view.data(&branch.way_body, "");
        let color = palette::cost(share);
        nodes = nodes.add(disc(view.at(branch.node_body), 3.0).set("fill", color));
    }
    let mut edges = Group::new().set("fill", "none").set("stroke-width", 1.8);
    for (shade, data) in shades.into_iter().enumerate() {
        if !data.is_empty() {
            let color = palette::cost((shade as f64 + 0.5) / SHADES as f64);
            edges = edges.add(Path::new().set("d", data).set("stroke", color));
        }
    }
    Group::new().add(edges).add(nodes)
}
