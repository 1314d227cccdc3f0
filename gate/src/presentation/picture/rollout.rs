//! The path of a car that holds a proposal.

use shm_config::config::Rollout;
use vehicle::{Action, State, Vehicle, step};

/// Step of the accurate rollout, s: the control period of Sec. 8.4.
const STEP_S: f64 = 0.1;
/// Step of the paper's rollout, s: its `dt_vis` (Sec. 4.2).
const PAPER_STEP_S: f64 = 1.5;

/// The states of a car that holds an action, from the present one, in its present body
/// frame; at least two. Eq. 3 to 6.
///
/// The accurate rollout has steps of 0.1 s until the horizon. The paper's rollout is a
/// single step for any horizon: it goes straight ahead for any steering, and the brake
/// acts only after it.
pub fn roll_out(
    vehicle: &Vehicle,
    action: Action,
    speed_mps: f64,
    (rollout, horizon_s): (Rollout, f64),
) -> Vec<State> {
    let (step_s, steps) = match rollout {
        // Rounding must not turn the 30 steps of a horizon of 3 s into 31.
        Rollout::Accurate => (STEP_S, (horizon_s / STEP_S - 1e-9).ceil().max(1.0)),
        Rollout::Paper => (PAPER_STEP_S, 1.0),
    };
    let control = action.control(vehicle);
    let begin = State::at_origin(speed_mps.max(0.0));
    std::iter::successors(Some(begin), |state| {
        Some(step(vehicle, state, control, step_s))
    })
    .take(steps as usize + 1)
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn constant_steering_gives_a_circle() {
        let vehicle = Vehicle::default();
        let action = Action {
            steer: 0.25,
            pedal: 0.0,
        };
        let states = roll_out(&vehicle, action, 8.0, (Rollout::Accurate, 3.0));
        assert_eq!(states.len(), 31);
        let radius_m = vehicle.wheelbase_m / (0.25 * vehicle.max_steer_rad()).tan();
        for state in &states {
            let middle_m = state.position.x.hypot(state.position.y - radius_m);
            // The chords of 0.8 m of Euler's method leave the circle outwards.
            assert!((middle_m / radius_m - 1.0).abs() < 0.1, "{state:?}");
        }
        let turned_rad = states.last().map(|state| state.heading_rad);
        let by_hand = vehicle::wrap_rad(24.0 / radius_m);
        assert!(turned_rad.is_some_and(|turned| (turned - by_hand).abs() < 1e-9));
    }

    #[test]
    fn the_papers_single_step_ignores_the_steering() {
        let vehicle = Vehicle::default();
        let action = Action {
            steer: 1.0,
            pedal: -1.0,
        };
        let states = roll_out(&vehicle, action, 10.0, (Rollout::Paper, 3.0));
        assert_eq!(states.len(), 2);
        let end = states[1].position;
        assert!((end.x - 15.0).abs() < 1e-12 && end.y == 0.0, "{end:?}");
    }
}
