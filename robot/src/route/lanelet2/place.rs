//! Where the nodes of a map are, in metres.

use std::collections::BTreeMap;

use nalgebra::{Matrix2x3, Vector3};
use vehicle::Point;

use super::osm::Node;

/// The ellipsoid of WGS 84: half its greater axis, m, and the square of its eccentricity.
const AXIS_M: f64 = 6_378_137.0;
const ECCENTRICITY_2: f64 = 6.694_379_990_141_317e-3;

/// The frame of a map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Frame {
    /// That of the nodes' own coordinates.
    Local,
    /// The plane that touches the Earth at a place.
    Tangent {
        /// The place, m from the middle of the Earth.
        origin: Vector3<f64>,
        /// The directions to the east and to the north.
        axes: Matrix2x3<f64>,
    },
}

impl Frame {
    /// The frame of these nodes; the tangent plane is that at the one with the least id, which
    /// does not change with their order.
    pub(super) fn of(nodes: &BTreeMap<i64, Node>) -> Result<Self, String> {
        let local = nodes.values().filter(|node| node.local_m.is_some()).count();
        let Some((_, first)) = nodes.first_key_value() else {
            return Err("it has no node".into());
        };
        match local {
            0 => Ok(Self::tangent(first.degrees)),
            all if all == nodes.len() => Ok(Self::Local),
            some => Err(format!(
                "{some} of {} nodes have local coordinates; all have to, or none",
                nodes.len()
            )),
        }
    }

    fn tangent(degrees: [f64; 2]) -> Self {
        let [(north, level), (sin, cos)] = degrees.map(|deg| deg.to_radians().sin_cos());
        Self::Tangent {
            origin: from_middle(degrees),
            axes: Matrix2x3::new(-sin, cos, 0.0, -north * cos, -north * sin, level),
        }
    }

    /// The place of a node.
    pub(super) fn of_node(&self, node: &Node) -> Point {
        let [x_m, y_m] = node.local_m.unwrap_or_default();
        let [latitude_deg, longitude_deg] = node.degrees;
        let place = self.of_degrees(latitude_deg, longitude_deg);
        place.unwrap_or(Point::new(x_m, y_m))
    }

    /// The place of a latitude and a longitude; `None` in local coordinates.
    pub(super) fn of_degrees(&self, latitude_deg: f64, longitude_deg: f64) -> Option<Point> {
        match self {
            Self::Local => None,
            Self::Tangent { origin, axes } => {
                let away = from_middle([latitude_deg, longitude_deg]) - origin;
                Some(Point::from(axes * away))
            }
        }
    }
}

/// A place of the ellipsoid, m from the middle of the Earth: x to the meridian of Greenwich,
/// z to the north pole.
fn from_middle(degrees: [f64; 2]) -> Vector3<f64> {
    let [(north, level), (sin, cos)] = degrees.map(|deg| deg.to_radians().sin_cos());
    let radius_m = AXIS_M / (1.0 - ECCENTRICITY_2 * north * north).sqrt();
    Vector3::new(
        radius_m * level * cos,
        radius_m * level * sin,
        radius_m * (1.0 - ECCENTRICITY_2) * north,
    )
}
