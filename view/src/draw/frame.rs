//! Title, legend and scale bar around a map.

use shm_config::message::Driver;
use sim::World;
use sim::observe::TICK_S;
use sim::spawn::ObstacleKind;
use sim::world::BodyKind;
use svg::Node;
use svg::node::element::{Circle, Element, Group, Line, Polygon, Rectangle, Text};

use super::canvas::{Canvas, HEAD_PX, px};
use super::palette;
use super::ride::Ride;

/// Left and right margin, px.
pub const SIDE_PX: f64 = 28.0;
/// Height of a legend row, px.
pub const ROW_PX: f64 = 30.0;
/// Gap between legend entries, px.
const GAP_PX: f64 = 26.0;
/// Width of a symbol including its gap, px.
const SYMBOL_PX: f64 = 32.0;
/// Width reserved for the scale bar at the right, px.
const SCALE_PX: f64 = 230.0;
/// Estimated width of a letter in the legend, px; generous, since fonts differ.
const LETTER_PX: f64 = 7.4;
/// Possible lengths of the scale bar, m.
const SCALES_M: [f64; 7] = [5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0];
/// Preferred length of the scale bar, px.
const SCALE_BAR_PX: f64 = 140.0;

/// Symbol of a legend entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Symbol {
    /// A thick line.
    Line,
    /// A filled rectangle.
    Box,
    /// A filled circle.
    Disc,
    /// A circle.
    Ring,
    /// A pale area with a beam that ends in a point.
    Scan,
    /// A triangle.
    Triangle,
    /// A star.
    Star,
}

/// An entry of the legend.
#[derive(Clone, Debug)]
pub struct Key {
    symbol: Symbol,
    color: &'static str,
    text: String,
}

/// Makes a legend entry.
pub fn key(symbol: Symbol, color: &'static str, text: &str) -> Key {
    Key {
        symbol,
        color,
        text: text.into(),
    }
}

/// The legend entries of what the map shows.
pub fn map_keys(world: &World) -> Vec<Key> {
    let mut keys = vec![
        key(Symbol::Box, palette::EGO, "ego"),
        key(Symbol::Box, palette::ROUTE, "route"),
        key(Symbol::Disc, palette::CHECKPOINT, "checkpoint"),
        key(Symbol::Box, palette::SIDEWALK, "sidewalk"),
    ];
    keys.extend(body_keys(world));
    keys
}

/// The legend of an episode; `driver_name` names the driver.
pub fn episode_keys(world: &World, ride: &Ride, driver_name: &str) -> Vec<Key> {
    let mut keys: Vec<Key> = ride
        .drivers()
        .map(|(driver, ticks)| {
            let seconds = ticks as f64 * TICK_S;
            let word = match driver {
                Driver::Expert => format!("{driver_name} drove"),
                Driver::Policy => "policy drove".into(),
                Driver::Brake => "braked".into(),
            };
            key(
                Symbol::Line,
                palette::driver(driver),
                &format!("{word}, {seconds:.1} s"),
            )
        })
        .collect();
    if ride.has_contacts() {
        keys.push(key(Symbol::Ring, palette::CONTACT, "contact"));
    }
    if ride.has_traffic() {
        keys.push(key(Symbol::Line, palette::TRAFFIC, "traffic path"));
    }
    keys.push(key(Symbol::Scan, palette::SCAN, "last scan"));
    keys.extend(map_keys(world));
    keys
}

fn body_keys(world: &World) -> Vec<Key> {
    let all = [
        key(Symbol::Box, palette::TRAFFIC, "traffic"),
        key(Symbol::Box, palette::BROKEN_DOWN, "broken down"),
        key(Symbol::Disc, palette::CONE, "cone, barrier"),
        key(Symbol::Triangle, palette::WARNING, "warning triangle"),
    ];
    let mut there = [false; 4];
    for body in world.bodies() {
        let index = match body.kind {
            BodyKind::Traffic(_) => 0,
            BodyKind::Obstacle(ObstacleKind::BrokenDown(_)) => 1,
            BodyKind::Obstacle(ObstacleKind::Cone | ObstacleKind::Barrier) => 2,
            BodyKind::Obstacle(ObstacleKind::Warning) => 3,
        };
        there[index] = true;
    }
    let all = all.into_iter().zip(there);
    all.filter_map(|(key, there)| there.then_some(key))
        .collect()
}

/// Adds title, legend and scale bar to the map.
pub fn finish(canvas: Canvas, title: &str, facts: &str, keys: &[Key]) -> String {
    let [width_px, map_px] = canvas.size_px();
    let top_px = HEAD_PX + map_px;
    let (legend, rows) = legend(keys, [SIDE_PX, top_px + 28.0], width_px - SCALE_PX);
    let around = head(title, facts).add(legend).add(scale(
        canvas.scale_px_per_m(),
        [width_px - SIDE_PX, top_px + 28.0],
    ));
    canvas.finish(26.0 + ROW_PX * f64::from(rows), around)
}

/// Title and facts above a picture.
pub fn head(title: &str, facts: &str) -> Group {
    Group::new()
        .add(text(title, [SIDE_PX, 40.0], 25.0).set("font-weight", 700))
        .add(text(facts, [SIDE_PX, 66.0], 14.5).set("fill", palette::FAINT))
}

/// A legend from its upper left corner to its right end, px, and its number of rows.
pub fn legend(keys: &[Key], [left, top]: [f64; 2], right: f64) -> (Group, u32) {
    let mut legend = Group::new();
    let (mut x, mut row) = (left, 0);
    for key in keys {
        let wide_px = SYMBOL_PX + key.text.chars().count() as f64 * LETTER_PX;
        if x + wide_px > right && x > left {
            (x, row) = (left, row + 1);
        }
        let y = top + ROW_PX * f64::from(row);
        legend =
            legend
                .add(symbol(key, [x, y]))
                .add(text(&key.text, [x + SYMBOL_PX, y + 5.0], 14.0));
        x += wide_px + GAP_PX;
    }
    (legend, row + 1)
}

/// Text whose baseline begins at a point, px.
pub fn text(words: &str, [x, y]: [f64; 2], size_px: f64) -> Text {
    Text::new(words)
        .set("x", px(x))
        .set("y", px(y))
        .set("font-size", px(size_px))
        .set("fill", palette::INK)
}

fn symbol(key: &Key, [x, y]: [f64; 2]) -> Element {
    let rim = |mut element: Element| -> Element {
        element.assign("stroke", palette::INK);
        element.assign("stroke-width", "0.8");
        element
    };
    match key.symbol {
        Symbol::Line => Line::new()
            .set("x1", px(x))
            .set("y1", px(y))
            .set("x2", px(x + 22.0))
            .set("y2", px(y))
            .set("stroke", key.color)
            .set("stroke-width", 6)
            .set("stroke-linecap", "round")
            .into(),
        Symbol::Box => rim(Rectangle::new()
            .set("x", px(x))
            .set("y", px(y - 6.0))
            .set("width", 22)
            .set("height", 12)
            .set("rx", 2)
            .set("fill", key.color)
            .into()),
        Symbol::Disc => rim(Circle::new()
            .set("cx", px(x + 11.0))
            .set("cy", px(y))
            .set("r", 6)
            .set("fill", key.color)
            .into()),
        Symbol::Ring => Circle::new()
            .set("cx", px(x + 11.0))
            .set("cy", px(y))
            .set("r", 7)
            .set("fill", "none")
            .set("stroke", key.color)
            .set("stroke-width", 3)
            .into(),
        Symbol::Scan => scan(key.color, [x, y]),
        Symbol::Star => rim(star([x + 11.0, y], 10.0).set("fill", key.color).into()),
        Symbol::Triangle => {
            let points = [[4.0, 6.0], [18.0, 6.0], [11.0, -7.0]];
            let points = points.map(|[dx, dy]| format!("{},{}", px(x + dx), px(y + dy)));
            rim(Polygon::new()
                .set("points", points.join(" "))
                .set("fill", key.color)
                .into())
        }
    }
}

/// The symbol of a scan, in the colours of the map.
fn scan(color: &str, [x, y]: [f64; 2]) -> Element {
    let area = Rectangle::new()
        .set("x", px(x))
        .set("y", px(y - 7.0))
        .set("width", 22)
        .set("height", 14)
        .set("fill", color)
        .set("fill-opacity", "0.35");
    let beam = Line::new()
        .set("x1", px(x))
        .set("y1", px(y + 4.0))
        .set("x2", px(x + 17.0))
        .set("y2", px(y - 3.0))
        .set("stroke", color)
        .set("stroke-width", 1.5);
    let end = Circle::new()
        .set("cx", px(x + 17.0))
        .set("cy", px(y - 3.0))
        .set("r", 3)
        .set("fill", color);
    Group::new().add(area).add(beam).add(end).into()
}

/// A five-pointed star around a point, px.
pub fn star([x, y]: [f64; 2], radius_px: f64) -> Polygon {
    let points: Vec<String> = (0..10)
        .map(|k| {
            let (sin, cos) = (f64::from(k) * std::f64::consts::PI / 5.0).sin_cos();
            let radius_px = if k % 2 == 0 {
                radius_px
            } else {
                0.42 * radius_px
            };
            format!("{},{}", px(x + sin * radius_px), px(y - cos * radius_px))
        })
        .collect();
    Polygon::new().set("points", points.join(" "))
}

/// A scale bar of a round length; its right end is at a point.
fn scale(scale_px_per_m: f64, [right, y]: [f64; 2]) -> Group {
    let off = |length_m: &f64| (length_m * scale_px_per_m - SCALE_BAR_PX).abs();
    let length_m = SCALES_M
        .into_iter()
        .min_by(|a, b| off(a).total_cmp(&off(b)))
        .unwrap_or(SCALES_M[0]);
    let left = right - length_m * scale_px_per_m;
    let mut bar = Group::new()
        .set("stroke", palette::FAINT)
        .set("stroke-width", 2);
    let ends = [
        [left, y, right, y],
        [left, y - 5.0, left, y + 5.0],
        [right, y - 5.0, right, y + 5.0],
    ];
    for [x1, y1, x2, y2] in ends {
        let line = Line::new()
            .set("x1", px(x1))
            .set("y1", px(y1))
            .set("x2", px(x2))
            .set("y2", px(y2));
        bar = bar.add(line);
    }
    let words = format!("{length_m} m");
    let label = text(&words, [(left + right) / 2.0, y + 20.0], 13.0)
        .set("text-anchor", "middle")
        .set("fill", palette::FAINT);
    Group::new().add(bar).add(label)
}
