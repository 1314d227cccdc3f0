//! All colours of the pictures.

use std::sync::LazyLock;

use shm_config::message::Driver;
use shm_config::palette::hex;

/// Background of the picture.
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
/// Contacts.
pub const CONTACT: &str = "#ff2d78";
/// The last scan.
pub const SCAN: &str = "#f7c948";

/// Free cells of the grid.
pub const FREE: &str = "#ffffff";
/// Occupied cells.
pub const OCCUPIED: &str = "#15181d";
/// The planned path and its goal.
pub const PATH: &str = "#1fb35b";
/// The planned path of a drive, which leaves [`PATH`] to the driver's colour.
pub const PLAN: &str = "#d3a4ff";
/// A predicted car: [`PATH`], nearly transparent.
pub const FOOTPRINT: &str = "#e3f5ea";
/// The car of a plan.
pub const CAR: &str = "#8fa3bd";

/// Colour scale of the cost-to-come, from the start to the maximum; dark enough for a white
/// background, and without green, the colour of the path.
pub const COSTS: [[u8; 3]; 5] = [
    [0x22, 0x1f, 0x9e],
    [0x7a, 0x1f, 0xb0],
    [0xc4, 0x2f, 0x86],
    [0xea, 0x66, 0x4b],
    [0xf9, 0xa8, 0x2b],
];

/// The colour of a share of the maximum cost, [0, 1].
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

/// The colour of a driver.
pub fn driver(driver: Driver) -> &'static str {
    static COLOURS: LazyLock<Vec<String>> = LazyLock::new(|| {
        let drivers = Driver::ALL.iter();
        drivers
            .map(|driver| hex(shm_config::palette::driver(*driver)))
            .collect()
    });
    &COLOURS[driver.code() as usize]
}

/// The colours of a moving picture, of which its palette begins.
pub fn drawn() -> Vec<String> {
    let fixed = [
        PAPER,
        GROUND,
        INK,
        SIDEWALK,
        ASPHALT,
        ROUTE,
        WHITE_LINE,
        YELLOW_LINE,
        CHECKPOINT,
        TRAFFIC,
        BROKEN_DOWN,
        CONE,
        WARNING,
        EGO,
        CONTACT,
        SCAN,
        PLAN,
    ];
    let drivers = Driver::ALL.iter().map(|of| driver(*of));
    fixed.into_iter().chain(drivers).map(String::from).collect()
}
