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

/// Who drove.
pub fn driver(driver: Driver) -> &'static str {
    match driver {
        Driver::Expert => "#37d67a",
        Driver::Policy => "#4db5ff",
        Driver::Brake => "#ff5648",
    }
}
