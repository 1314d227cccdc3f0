//! Axes in metres and the colour bar of the costs.

use svg::node::element::{Group, Line};
use vehicle::Point;

use super::figure::plate;
use super::view::{LEFT_PX, View, WIDTH_PX};
use crate::draw::canvas::{HEAD_PX, px};
use crate::draw::frame::{SIDE_PX, text};
use crate::draw::palette;

/// The colour bar of the tree's costs.
pub(super) fn colour_bar(view: &View, greatest_m: f64) -> Group {
    let (left, width) = (LEFT_PX + WIDTH_PX + 34.0, 20.0);
    let (top, height) = (HEAD_PX, view.height_px());
    let mut bar = Group::new().add(
        plate([left, top], [width, height])
            .set("fill", "url(#costs)")
            .set("stroke", palette::INK),
    );
    let step_m = if greatest_m > 12.0 { 5.0 } else { 2.0 };
    for k in 0..=(greatest_m / step_m) as u32 {
        let cost_m = f64::from(k) * step_m;
        let y = top + height * (1.0 - cost_m / greatest_m);
        bar = bar
            .add(tick([left + width, y], [left + width + 6.0, y]))
            .add(text(
                &cost_m.to_string(),
                [left + width + 11.0, y + 5.0],
                14.0,
            ));
    }
    let [x, y] = [left + width + 52.0, top + height / 2.0];
    bar.add(
        text("cost-to-come, m", [x, y], 15.0)
            .set("text-anchor", "middle")
            .set("transform", format!("rotate(-90 {} {})", px(x), px(y))),
    )
}

fn tick([x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) -> Line {
    Line::new()
        .set("x1", px(x1))
        .set("y1", px(y1))
        .set("x2", px(x2))
        .set("y2", px(y2))
        .set("stroke", palette::INK)
        .set("stroke-width", 1.2)
}

/// The x and the y axis, in metres.
pub(super) fn axes(view: &View) -> Group {
    let mut axes = Group::new().add(
        plate([LEFT_PX, HEAD_PX], [WIDTH_PX, view.height_px()])
            .set("fill", "none")
            .set("stroke", palette::INK)
            .set("stroke-width", 1.2),
    );
    let bottom = view.bottom_px();
    let marks = |low_m: f64, high_m: f64, step_m: i32| {
        (low_m.ceil() as i32..=high_m.floor() as i32).filter(move |m| m % step_m == 0)
    };
    for x_m in marks(view.x_min_m, view.x_max_m, 5) {
        let [x, _] = view.at(Point::new(x_m.into(), 0.0));
        let label = text(&x_m.to_string(), [x, bottom + 24.0], 14.0).set("text-anchor", "middle");
        axes = axes.add(tick([x, bottom], [x, bottom + 6.0])).add(label);
    }
    for y_m in marks(view.right_m, view.left_m, 2) {
        let [_, y] = view.at(Point::new(0.0, y_m.into()));
        let label = text(&y_m.to_string(), [LEFT_PX - 12.0, y + 5.0], 14.0);
        axes = axes
            .add(tick([LEFT_PX - 6.0, y], [LEFT_PX, y]))
            .add(label.set("text-anchor", "end"));
    }
    let middle = LEFT_PX + WIDTH_PX / 2.0;
    let [x, y] = [SIDE_PX + 6.0, HEAD_PX + view.height_px() / 2.0];
    axes.add(text("x, m forward", [middle, bottom + 48.0], 15.0).set("text-anchor", "middle"))
        .add(
            text("y, m left", [x, y], 15.0)
                .set("text-anchor", "middle")
                .set("transform", format!("rotate(-90 {} {})", px(x), px(y))),
        )
}
