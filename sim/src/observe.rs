//! From the state of an episode to the ego's observation.
//! Source: `obs/state_obs.py` and `_get_info_for_checkpoint`.

use shm_config::message::{Bend, Checkpoint, Ego, Road};
use vehicle::{Action, Vector, wrap_rad};

use crate::dynamics::Motion;
use crate::lane::Turn;
use crate::navigation::Navigator;
use crate::road::{Network, RoadId};
use crate::rules::Edges;

/// Length of a tick, s.
pub const TICK_S: f64 = 0.1;

/// The car itself. `before_world` is its heading one tick ago, as a unit
/// vector; the speed is the one over the ground, which a slide makes larger
/// than the one along the heading.
pub(crate) fn ego(motion: &Motion, before_world: Vector, last: Action) -> Ego {
    let position = motion.seen_position();
    let forward = motion.seen_forward();
    let turned_rad = before_world
        .perp(&forward)
        .atan2(before_world.dot(&forward));
    Ego {
        x_world_m: position.x,
        y_world_m: position.y,
        heading_world_rad: motion.seen_heading_rad(),
        speed_mps: motion.speed_mps(),
        yaw_rate_radps: turned_rad / TICK_S,
        steer: last.steer,
        pedal: last.pedal,
    }
}

/// The road where the car is.
pub(crate) fn road(network: &Network, navigator: &Navigator, motion: &Motion) -> Road {
    let position = motion.seen_position();
    let edges = Edges::of(network, navigator, position);
    let right_lane = network.road(navigator.road()).last_lane();
    let (along_m, _) = navigator.coordinates(network, right_lane, position);
    let lane_rad = network.lane(right_lane).heading_at(along_m);
    let (_, lateral_m) = navigator.coordinates(network, navigator.lane(), position);
    Road {
        left_m: edges.left_m,
        right_m: edges.right_m,
        heading_rad: wrap_rad(motion.seen_heading_rad() - lane_rad),
        offset_m: -lateral_m,
        lane_width_m: network.lane(navigator.lane()).width_m,
    }
}

/// The ends of the current road and of the next one, or the last one twice.
pub(crate) fn checkpoints(
    network: &Network,
    navigator: &Navigator,
    motion: &Motion,
) -> [Checkpoint; 2] {
    let next = navigator.next_road().unwrap_or(navigator.road());
    [navigator.road(), next].map(|road| checkpoint(network, navigator, motion, road))
}

fn checkpoint(
    network: &Network,
    navigator: &Navigator,
    motion: &Motion,
    road: RoadId,
) -> Checkpoint {
    let lane = network.lane(network.road(road).first_lane);
    // The middle is reckoned with the current road's width, also of the next road.
    let count = f64::from(network.road(navigator.road()).lane_count);
    let width_m = network.lane(navigator.lane()).width_m;
    let middle_m = (count / 2.0 - 0.5) * width_m;
    let away = lane.position(lane.length_m, middle_m) - motion.seen_position();
    let forward = motion.seen_forward();
    let (bend, bend_radius_m, bend_angle_rad) = match lane.bend_radius() {
        None => (Bend::Straight, 0.0, 0.0),
        Some((radius_m, turn)) => {
            let bend = match turn {
                Turn::Left => Bend::Left,
                Turn::Right => Bend::Right,
            };
            (bend, radius_m, lane.length_m / radius_m)
        }
    };
    Checkpoint {
        x_body_m: forward.dot(&away),
        y_body_m: forward.perp(&away),
        bend_radius_m,
        bend_angle_rad,
        bend: bend.code(),
        reserved: 0,
    }
}
