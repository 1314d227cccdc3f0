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
    /// The speed asked for last; `None` where the measured one is to be gone on from: at the
    /// start, after a brake, and after a pause.
    speed_mps: Option<f64>,
}

impl Setpoint {
    /// For a car at any speed.
    pub fn new(vehicle: Vehicle) -> Self {
        Self {
            vehicle,
            speed_mps: None,
        }
    }

    /// What to ask for when an action holds for the next `step_s`, s. The brake asks for a
    /// stand at once. The speed asked for stays between what the full brake and what the
    /// action's own acceleration make of the measured speed in [`LEAD_S`].
    pub fn drive(&mut self, action: Action, measured_mps: f64, step_s: f64) -> Drive {
        let control = action.control(&self.vehicle);
        let forward_mps = measured_mps.max(0.0);
        let least_mps = (forward_mps - self.vehicle.max_brake_mps2 * LEAD_S).max(0.0);
        let most_mps = forward_mps + control.accel_mps2.max(0.0) * LEAD_S;
        self.speed_mps = match action.pedal {
            pedal if pedal <= -1.0 => None,
            _ => {
                let before_mps = self.speed_mps.unwrap_or(forward_mps);
                let speed_mps = before_mps + control.accel_mps2 * step_s;
                Some(speed_mps.clamp(least_mps, most_mps))
            }
        };
        Drive {
            steer_rad: control.steer_rad,
            speed_mps: self.speed_mps.map_or(STAND.speed_mps, |speed_mps| {
                speed_mps.min(self.vehicle.max_speed_mps)
            }),
            accel_mps2: control.accel_mps2,
        }
    }

    /// Brakes to a stand.
    pub fn brake(&mut self) -> Drive {
        self.forget();
        Drive {
            accel_mps2: -self.vehicle.max_brake_mps2,
            ..STAND
        }
    }

    /// Goes on from the measured speed: steps were not integrated, or the car is another.
    pub fn forget(&mut self) {
        self.speed_mps = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn action(pedal: f64) -> Action {
        Action { steer: 0.0, pedal }
    }

    fn setpoint() -> Setpoint {
        Setpoint::new(Vehicle::default())
    }

    #[test]
    fn a_car_that_cruises_is_asked_for_its_speed_from_the_first_step_on() {
        let mut setpoint = setpoint();
        for _ in 0..100 {
            let drive = setpoint.drive(action(0.0), 10.0, 0.01);
            assert_eq!((drive.speed_mps, drive.accel_mps2), (10.0, 0.0));
        }
        // Also when steps were left out, and after a brake that was let go.
        setpoint.forget();
        assert_eq!(setpoint.drive(action(0.0), 4.0, 0.01).speed_mps, 4.0);
        assert_eq!(setpoint.drive(action(-1.0), 4.0, 0.01).speed_mps, 0.0);
        assert_eq!(setpoint.drive(action(0.0), 3.5, 0.01).speed_mps, 3.5);
        assert_eq!(setpoint.brake().speed_mps, 0.0);
        assert_eq!(setpoint.drive(action(0.0), 3.0, 0.01).speed_mps, 3.0);
    }

    #[test]
    fn what_is_asked_for_stays_near_what_is_measured() {
        let vehicle = Vehicle::default();
        let mut setpoint = setpoint();
        for _ in 0..1_000 {
            setpoint.drive(action(1.0), 0.0, 0.01);
        }
        // A car that does not follow.
        let lead_mps = vehicle.max_accel_mps2 * LEAD_S;
        let asked_mps = setpoint.drive(action(1.0), 0.0, 0.01).speed_mps;
        assert!((asked_mps - lead_mps).abs() < 1e-9, "{asked_mps}");
        // A measured speed far above, such as after a collision.
        let asked_mps = setpoint.drive(action(0.0), 12.0, 0.01).speed_mps;
        let least_mps = 12.0 - vehicle.max_brake_mps2 * LEAD_S;
        assert!((asked_mps - least_mps).abs() < 1e-9, "{asked_mps}");
        // One far below.
        assert_eq!(setpoint.drive(action(-0.1), 1.0, 0.01).speed_mps, 1.0);
        assert_eq!(setpoint.drive(action(0.0), -2.0, 0.01).speed_mps, 0.0);
    }

    #[test]
    fn a_pedal_is_integrated() {
        let mut setpoint = setpoint();
        let accel_mps2 = 0.5 * Vehicle::default().max_accel_mps2;
        for step in 1..=20 {
            let asked_mps = setpoint.drive(action(0.5), 5.0, 0.01).speed_mps;
            let expected_mps = 5.0 + accel_mps2 * 0.01 * f64::from(step);
            assert!((asked_mps - expected_mps).abs() < 1e-9, "{asked_mps}");
        }
    }
}
