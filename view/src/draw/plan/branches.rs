//! Draws the search tree of a plan, coloured by cost-to-come.

use recorder::standard::Branch;
use svg::node::element::{Group, Path};

use super::figure::disc;
use super::view::View;
use crate::draw::palette;

/// Number of colours: edges with nearly the same cost share one SVG path.
const SHADES: usize = 24;

/// The largest cost-to-come of a node, m.
pub(crate) fn greatest_cost_m(branches: &[Branch]) -> f64 {
    let costs = branches.iter().map(|branch| branch.cost_m);
    costs.fold(f64::MIN_POSITIVE, f64::max)
}

/// Draws all edges, then all nodes.
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
