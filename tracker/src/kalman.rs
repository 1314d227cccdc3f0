use nalgebra::{Matrix2, Vector2};

/// A Kalman filter over a measured quantity and what drives it: position and
/// velocity, or speed and gain of the engine.
///
/// `y' = keep * y + drive * g`, `g' = g`; `y` is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Kalman {
    /// `(y, g)`.
    state: Vector2<f64>,
    covariance: Matrix2<f64>,
}

impl Kalman {
    /// At a measurement, with a first guess of the driver; standard deviations.
    pub(crate) fn new((y, y_deviation): (f64, f64), (g, g_deviation): (f64, f64)) -> Self {
        Self {
            state: Vector2::new(y, g),
            covariance: Matrix2::from_diagonal(&Vector2::new(
                y_deviation * y_deviation,
                g_deviation * g_deviation,
            )),
        }
    }

    /// One step in time. `noise` is the standard deviation that the driver
    /// changes by meanwhile.
    pub(crate) fn predict(&mut self, keep: f64, drive: f64, noise: f64) {
        let step = Matrix2::new(keep, drive, 0.0, 1.0);
        self.state = step * self.state;
        // What changes the driver has also moved the quantity, by half as much.
        let push = Vector2::new(0.5 * drive, 1.0) * noise;
        self.covariance = step * self.covariance * step.transpose() + push * push.transpose();
    }

    /// Takes a measurement with this standard deviation in.
    pub(crate) fn measure(&mut self, y: f64, deviation: f64) {
        let total = self.covariance[(0, 0)] + deviation * deviation;
        let gain = self.covariance.column(0) / total;
        self.state += gain * (y - self.state.x);
        self.covariance -= gain * self.covariance.row(0);
    }

    /// The quantity.
    pub(crate) fn value(&self) -> f64 {
        self.state.x
    }

    /// What drives it.
    pub(crate) fn driver(&self) -> f64 {
        self.state.y
    }
}
