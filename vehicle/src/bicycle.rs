#[cfg(not(feature = "std"))]
use crate::Float as _;
use crate::{Control, Point, Pose, Vector, Vehicle, pose, wrap_rad};

/// State of the kinematic bicycle, `s_k` of Sec. 8.4.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    /// Position, m.
    pub position: Point,
    /// Yaw, rad, counter-clockwise, wrapped.
    pub heading_rad: f64,
    /// Longitudinal speed, m/s.
    pub speed_mps: f64,
}

impl State {
    /// At the origin of the body frame, facing x.
    pub fn at_origin(speed_mps: f64) -> Self {
        Self {
            position: Point::origin(),
            heading_rad: 0.0,
            speed_mps,
        }
    }

    /// The pose of the body in the frame of `position`.
    pub fn pose(&self) -> Pose {
        pose(self.position.x, self.position.y, self.heading_rad)
    }
}

/// One step of the discrete kinematic bicycle, Eq. 3 to 6.
///
/// Unlike Eq. 6 alone the speed stays in [0, top speed]: the brake does not
/// drive backwards, and the engine is cut at the top.
pub fn step(vehicle: &Vehicle, state: &State, control: Control, step_s: f64) -> State {
    let State {
        position,
        heading_rad,
        speed_mps,
    } = *state;
    let (sin, cos) = heading_rad.sin_cos();
    let yaw_rate_radps = speed_mps / vehicle.wheelbase_m * control.steer_rad.tan();
    State {
        position: position + step_s * speed_mps * Vector::new(cos, sin),
        heading_rad: wrap_rad(heading_rad + step_s * yaw_rate_radps),
        speed_mps: (speed_mps + step_s * control.accel_mps2)
            .clamp(0.0, vehicle.max_speed_mps.max(speed_mps)),
    }
}
