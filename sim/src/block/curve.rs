//! A bend, and a straight road after it.

use super::builder::{Bend, Builder, Built, Lines, RoadName, bend_and_straight};

pub(super) fn build(out: &mut Builder<'_>, bend: Bend, length_m: f64) -> Built {
    let (arc, straight) = bend_and_straight(&out.basic_lane(), bend, length_m);
    let bend_road = RoadName {
        from: out.entry.positive.to,
        to: out.node(0, 0),
    };
    let straight_road = RoadName {
        from: bend_road.to,
        to: out.node(0, 1),
    };
    for (lane, road) in [(arc, bend_road), (straight, straight_road)] {
        out.place(lane, out.lane_count(), road, Lines::ROAD)?;
        out.place_opposite(road, Lines::ROAD)?;
    }
    out.add_socket(straight_road);
    Ok(())
}
