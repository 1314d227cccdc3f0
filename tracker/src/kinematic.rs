use nalgebra::{Matrix2, Matrix2x4, Matrix4, Vector2, Vector4};
use vehicle::{Point, Vector};

/// Farther from where it should be than so many deviations, a measurement counts less.
const GATE_DEVIATIONS: f64 = 3.0;

/// A Kalman filter of a point with constant velocity in a plane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Kinematic {
    /// Position, m, and velocity, m/s.
    state: Vector4<f64>,
    covariance: Matrix4<f64>,
}

impl Kinematic {
    /// At rest, as far as is known; standard deviations in m and m/s.
    pub(crate) fn new(at: Point, at_deviation: f64, velocity_deviation: f64) -> Self {
        let (at_m2, velocity) = (at_deviation.powi(2), velocity_deviation.powi(2));
        Self {
            state: Vector4::new(at.x, at.y, 0.0, 0.0),
            covariance: Matrix4::from_diagonal(&Vector4::new(at_m2, at_m2, velocity, velocity)),
        }
    }

    /// One step in time; `noise` is the standard deviation that each component of the
    /// velocity changes by meanwhile, m/s.
    pub(crate) fn predict(&mut self, step_s: f64, noise: f64) {
        let mut step = Matrix4::identity();
        (step[(0, 2)], step[(1, 3)]) = (step_s, step_s);
        self.state = step * self.state;
        self.covariance = step * self.covariance * step.transpose();
        // What changes the velocity has also moved the point, by half as much.
        for axis in 0..2 {
            let mut push = Vector4::zeros();
            (push[axis], push[axis + 2]) = (0.5 * step_s * noise, noise);
            self.covariance += push * push.transpose();
        }
    }

    /// Takes a measured position in: deviations along a direction and across it, m.
    pub(crate) fn measure(&mut self, at: Point, forward: Vector, (along, across): (f64, f64)) {
        let left = Vector::new(-forward.y, forward.x);
        let noise = forward * forward.transpose() * (along * along)
            + left * left.transpose() * (across * across);
        let pick = Matrix2x4::identity();
        let off: Vector2<f64> = at.coords - self.state.fixed_rows::<2>(0);
        let spread = self.covariance.fixed_view::<2, 2>(0, 0).into_owned();
        let Some(inverse) = (spread + noise).try_inverse() else {
            return;
        };
        let deviations = off.dot(&(inverse * off)).max(0.0).sqrt();
        let doubt = (deviations / GATE_DEVIATIONS).max(1.0).powi(2);
        let Some(inverse): Option<Matrix2<f64>> = (spread + noise * doubt).try_inverse() else {
            return;
        };
        let gain = self.covariance * pick.transpose() * inverse;
        self.state += gain * off;
        self.covariance -= gain * pick * self.covariance;
    }

    /// The point is now another one of the same body, by this away, m.
    pub(crate) fn shift(&mut self, by: Vector) {
        self.state[0] += by.x;
        self.state[1] += by.y;
    }

    /// Where it is.
    pub(crate) fn at(&self) -> Point {
        Point::new(self.state[0], self.state[1])
    }

    /// Standard deviation of a component of its velocity, m/s.
    pub(crate) fn velocity_deviation(&self) -> f64 {
        ((self.covariance[(2, 2)] + self.covariance[(3, 3)]) / 2.0).sqrt()
    }

    /// Its velocity, m/s.
    pub(crate) fn velocity(&self) -> Vector {
        Vector::new(self.state[2], self.state[3])
    }
}
