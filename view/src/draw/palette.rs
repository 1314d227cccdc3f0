//! Every colour, once.

use shm_config::message::Driver;

/// Paper behind everything.
pub const PAPER: &str = "#f6f4ee";
/// Ground beside the roads.
pub const GROUND: &str = "#e8ebe0";
/// Text.
pub const INK: &str = "#22272e";
/// Secondary text and scales.
pub const FAINT: &str = "#6d7480";
/// Sidewalks.
pub const SIDEWALK: &str = "#d3cfc3";
/// Asphalt.
pub const ASPHALT: &str = "#565c66";
/// Asphalt of the route.
pub const ROUTE: &str = "#3f5878";
/// Painted lines.
pub const WHITE_LINE: &str = "#f4f5f6";
/// Lines between the two directions.
pub const YELLOW_LINE: &str = "#f2c14e";
/// Checkpoints and the goal.
pub const CHECKPOINT: &str = "#9fd3ff";
/// Other cars.
pub const TRAFFIC: &str = "#c9b8e8";
/// Cars that have broken down.
pub const BROKEN_DOWN: &str = "#9a8f86";
/// Cones and barriers.
pub const CONE: &str = "#ff8c37";
/// Warning triangles.
pub const WARNING: &str = "#ffd23f";
/// The ego.
pub const EGO: &str = "#ffffff";
/// What was touched, where.
pub const CONTACT: &str = "#ff2d78";
/// The last scan.
pub const SCAN: &str = "#f7c948";

/// Free cells of the grid.
pub const FREE: &str = "#ffffff";
/// Occupied cells.
pub const OCCUPIED: &str = "#15181d";
/// The planned path and its goal.
pub const PATH: &str = "#1fb35b";
/// A predicted car, [`PATH`] seen through.
pub const FOOTPRINT: &str = "#e3f5ea";
/// The car of a plan.
pub const CAR: &str = "#8fa3bd";

/// Cost-to-come, from the start's to the greatest; dark enough for white paper,
/// and without green, which is the path's.
pub const COSTS: [[u8; 3]; 5] = [
    [0x22, 0x1f, 0x9e],
    [0x7a, 0x1f, 0xb0],
    [0xc4, 0x2f, 0x86],
    [0xea, 0x66, 0x4b],
    [0xf9, 0xa8, 0x2b],
];

/// The colour of a share of the greatest cost, [0, 1].
pub fn cost(share: f64) -> String {
    let at = share.clamp(0.0, 1.0) * (COSTS.len() - 1) as f64;
    let below = (at as usize).min(COSTS.len() - 2);
    let part = at - below as f64;
    let mixed = |k: usize| {
        let (low, high) = (COSTS[below][k], COSTS[below + 1][k]);
        (f64::from(low) + (f64::from(high) - f64::from(low)) * part).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", mixed(0), mixed(1), mixed(2))
}

/// The driver.
pub fn driver(driver: Driver) -> &'static str {
    match driver {
        Driver::Expert => "#37d67a",
        Driver::Policy => "#4db5ff",
        Driver::Brake => "#ff5648",
    }
}
