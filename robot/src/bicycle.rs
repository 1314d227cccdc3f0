//! The kinematic bicycle as a simulated car.

use shm_config::message::Ego;
use vehicle::{Action, Point, State, Vehicle, step};

/// A car that moves as [`vehicle::step`] says, for simulations.
#[derive(Clone, Copy, Debug)]
pub struct Bicycle {
    /// Its measures and limits.
    pub vehicle: Vehicle,
    /// Where it is, and how fast.
    pub state: State,
    /// Turning rate over the last step, rad/s, counter-clockwise.
    pub yaw_rate_radps: f64,
}

impl Bicycle {
    /// A car that stands at the origin of the world, facing x.
    pub fn new(vehicle: Vehicle) -> Self {
        Self {
            vehicle,
            state: State::at_origin(0.0),
            yaw_rate_radps: 0.0,
        }
    }

    /// Puts it to stand at a place of the world, m, with a heading, rad counter-clockwise.
    pub fn place(&mut self, place_world: Point, heading_world_rad: f64) {
        *self = Self::new(self.vehicle);
        self.state.position = place_world;
        self.state.heading_rad = heading_world_rad;
    }

    /// Moves it by an action that holds for a time, s.
    pub fn advance(&mut self, action: Action, step_s: f64) {
        let control = action.control(&self.vehicle);
        let speed_mps = self.state.speed_mps;
        self.state = step(&self.vehicle, &self.state, control, step_s);
        self.yaw_rate_radps = speed_mps / self.vehicle.wheelbase_m * control.steer_rad.tan();
    }

    /// Fills pose, speed and turning rate of an observation's car.
    pub fn fill(&self, ego: &mut Ego) {
        ego.x_world_m = self.state.position.x;
        ego.y_world_m = self.state.position.y;
        ego.heading_world_rad = self.state.heading_rad;
        ego.speed_mps = self.state.speed_mps;
        ego.yaw_rate_radps = self.yaw_rate_radps;
    }
}
