//! An action as angle, speed and acceleration: what an Ackermann-steered car takes.

use recorder::standard::Drive;
use vehicle::{Action, Vehicle};

/// The speed asked for is never farther from the measured one than what the car can gain in
/// this time, s: a car that does not follow is not asked for more and more, and one that
/// ignores the acceleration still begins to move against its friction.
const LEAD_S: f64 = 0.5;

/// What is asked for when the car is to brake to a stand.
pub const STAND: Drive = Drive {
    steer_rad: 0.0,
    speed_mps: 0.0,
    accel_mps2: 0.0,
};

/// Integrates the pedal to the speed that a car without a pedal takes.
#[derive(Debug, Clone, Copy)]
pub struct Setpoint {
    vehicle: Vehicle,
    speed_mps: f64,
}

impl Setpoint {
    /// For a car that stands.
    pub fn new(vehicle: Vehicle) -> Self {
        Self {
            vehicle,
            speed_mps: 0.0,
        }
    }

    /// What to ask for when an action holds for the next `step_s`, s. The brake asks for a
    /// stand at once.
    pub fn drive(&mut self, action: Action, measured_mps: f64, step_s: f64) -> Drive {
        let control = action.control(&self.vehicle);
        let forward_mps = measured_mps.max(0.0);
        let lead_mps = control.accel_mps2.max(0.0) * LEAD_S;
        self.speed_mps = match action.pedal {
            pedal if pedal <= -1.0 => 0.0,
            _ => (self.speed_mps + control.accel_mps2 * step_s)
                .clamp(0.0, forward_mps + lead_mps)
                .min(self.vehicle.max_speed_mps),
        };
        Drive {
            steer_rad: control.steer_rad,
            speed_mps: self.speed_mps,
            accel_mps2: control.accel_mps2,
        }
    }

    /// Brakes to a stand.
    pub fn brake(&mut self) -> Drive {
        self.speed_mps = 0.0;
        Drive {
            accel_mps2: -self.vehicle.max_brake_mps2,
            ..STAND
        }
    }
}
