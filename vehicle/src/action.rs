use crate::Vehicle;

/// A normalised action, each component in [-1, 1] once clamped.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Action {
    /// Steering; positive turns left.
    pub steer: f64,
    /// Positive drives, negative brakes.
    pub pedal: f64,
}

/// What an action means for a given car.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Control {
    /// Front-wheel angle, rad, positive left.
    pub steer_rad: f64,
    /// Longitudinal acceleration, m/s².
    pub accel_mps2: f64,
}

impl Action {
    /// Wheels straight, full brake: the answer to silence and to unknown cases.
    pub const BRAKE: Self = Self {
        steer: 0.0,
        pedal: -1.0,
    };

    /// Both components are numbers.
    pub fn is_finite(self) -> bool {
        self.steer.is_finite() && self.pedal.is_finite()
    }

    /// Both components limited to [-1, 1]; a non-finite action is [`Action::BRAKE`].
    pub fn clamped(self) -> Self {
        if !self.is_finite() {
            return Self::BRAKE;
        }
        Self {
            steer: self.steer.clamp(-1.0, 1.0),
            pedal: self.pedal.clamp(-1.0, 1.0),
        }
    }

    /// Physical control (Sec. 8.4: fixed scale factors). Braking has its own
    /// factor because brakes are stronger than the engine.
    pub fn control(self, vehicle: &Vehicle) -> Control {
        let action = self.clamped();
        let scale_mps2 = if action.pedal < 0.0 {
            vehicle.max_brake_mps2
        } else {
            vehicle.max_accel_mps2
        };
        Control {
            steer_rad: action.steer * vehicle.max_steer_rad(),
            accel_mps2: action.pedal * scale_mps2,
        }
    }
}

impl Control {
    /// The action that asks for this control; the inverse of [`Action::control`]
    /// inside the limits, clamped outside.
    pub fn action(self, vehicle: &Vehicle) -> Action {
        let scale_mps2 = if self.accel_mps2 < 0.0 {
            vehicle.max_brake_mps2
        } else {
            vehicle.max_accel_mps2
        };
        Action {
            steer: self.steer_rad / vehicle.max_steer_rad(),
            pedal: self.accel_mps2 / scale_mps2,
        }
        .clamped()
    }
}
