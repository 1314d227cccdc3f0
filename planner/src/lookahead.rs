use shm_config::message::{Plan, Waypoint};

/// The paper's `d_LA`, m.
pub const LOOKAHEAD_M: f64 = 2.0;

/// The waypoint to steer for: of those at least `distance_m` from the origin
/// the nearest, else the last; `None` when the plan has none (Sec. 4.1.1).
///
/// Only waypoints count, no point between two of them.
pub fn lookahead(plan: &Plan, distance_m: f64) -> Option<Waypoint> {
    let norm_m = |waypoint: &Waypoint| waypoint.x_body_m.hypot(waypoint.y_body_m);
    plan.waypoints()
        .iter()
        .filter(|waypoint| norm_m(waypoint) >= distance_m)
        .min_by(|a, b| norm_m(a).total_cmp(&norm_m(b)))
        .or(plan.waypoints().last())
        .copied()
}
