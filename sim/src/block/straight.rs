//! A straight road.

use super::builder::{Builder, Built, Lines, RoadName, extended};
use crate::lane::LineType;

pub(super) fn build(out: &mut Builder<'_>, length_m: f64) -> Built {
    let lane = extended(
        &out.basic_lane(),
        length_m,
        [LineType::Broken, LineType::Side],
    );
    let road = RoadName {
        from: out.entry.positive.to,
        to: out.node(0, 0),
    };
    out.place(lane, out.lane_count(), road, Lines::ROAD)?;
    out.place_opposite(road, Lines::ROAD)?;
    out.add_socket(road);
    Ok(())
}
