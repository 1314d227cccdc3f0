use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use shm_config::Instant;
use shm_config::message::Ego;
use vehicle::{Pose, pose, wrap_rad};

use super::measurement::INFORMATION_MIN;
use super::{ACCEL, ACCEL_BIAS, GYRO_BIAS, HEADING, SPEED, X, Y, YAW_RATE};
use super::{GATE, Measurement, Noise, STATES, Settings};

/// The state.
pub type Mean = SVector<f64, STATES>;
/// The covariance of the state's error.
pub type Covariance = SMatrix<f64, STATES, STATES>;

/// The state with the pose at the keyframe.
const ALL: usize = STATES + 3;
const KEY_X: usize = STATES;
const KEY_Y: usize = STATES + 1;
const KEY_HEADING: usize = STATES + 2;

type All = SVector<f64, ALL>;
type AllCovariance = SMatrix<f64, ALL, ALL>;

/// Longest step of the prediction, s: at 3 rad/s the heading turns by 9 degrees in it, and
/// the chord is then 0.1 % shorter than the arc.
const STEP_MAX_S: f64 = 0.05;
/// Most steps of one prediction; beyond 10 s they are longer.
const STEPS_MAX: f64 = 200.0;

/// What a measurement did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Verdict {
    /// Normalised innovation squared: of chi-square with `freedoms` degrees of freedom when
    /// noise and covariance are right.
    pub nis: f64,
    /// Numbers that were measured; 0 for a keyframe.
    pub freedoms: usize,
    /// It is below its [`GATE`] and applied; of a place also when too many before it were
    /// rejected ([`Settings::places_rejected_max`]).
    pub is_applied: bool,
}

/// The state at an instant with its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The instant.
    pub at: Instant,
    /// The state; [`X`] to [`ACCEL_BIAS`] are its places.
    pub mean: Mean,
    /// Of its error, in the squares of the state's units.
    pub covariance: Covariance,
    /// The newest keyframe before, and the body of `at` in its body frame.
    pub keyframe: Option<(Instant, Pose)>,
}

impl Estimate {
    /// The pose of the body in the world, m and rad.
    pub fn world_from_body(&self) -> Pose {
        pose(self.mean[X], self.mean[Y], self.mean[HEADING])
    }

    /// Speed along the heading, m/s.
    pub fn speed_mps(&self) -> f64 {
        self.mean[SPEED]
    }

    /// Turning rate, rad/s, counter-clockwise.
    pub fn yaw_rate_radps(&self) -> f64 {
        self.mean[YAW_RATE]
    }

    /// Standard deviation of one number of the state.
    pub fn std(&self, place: usize) -> f64 {
        self.covariance[(place, place)].max(0.0).sqrt()
    }

    /// Fills pose, speed and turning rate of an observation's car.
    pub fn fill(&self, ego: &mut Ego) {
        ego.x_world_m = self.mean[X];
        ego.y_world_m = self.mean[Y];
        ego.heading_world_rad = self.mean[HEADING];
        ego.speed_mps = self.mean[SPEED];
        ego.yaw_rate_radps = self.mean[YAW_RATE];
    }

    /// Error of the estimate: the state minus the truth, its heading wrapped.
    pub fn error(&self, truth: &Mean) -> Mean {
        let mut error = self.mean - truth;
        error[HEADING] = wrap_rad(error[HEADING]);
        error
    }

    /// Normalised estimation error squared against the truth (Bar-Shalom et al., section
    /// 5.4.2): of chi-square with [`STATES`] degrees of freedom when the covariance is
    /// right; `None` when it has no inverse.
    pub fn nees(&self, truth: &Mean) -> Option<f64> {
        let error = self.error(truth);
        let inverse = self.covariance.cholesky()?;
        Some(error.dot(&inverse.solve(&error)))
    }
}

/// The filter's knowledge after a measurement.
#[derive(Debug, Clone, Copy)]
pub(super) struct Belief {
    pub(super) at: Instant,
    mean: All,
    covariance: AllCovariance,
    /// When the keyframe was taken.
    pub(super) keyframe: Option<Instant>,
    /// Places rejected in succession.
    places_rejected: u32,
}

/// Numbers that were measured, against what the belief says of them.
struct Innovation<const M: usize> {
    residual: SVector<f64, M>,
    /// Derivative of the prediction by the state. A row of zeros measures nothing.
    by_state: SMatrix<f64, M, ALL>,
    noise: SMatrix<f64, M, M>,
    freedoms: usize,
}

impl Belief {
    pub(super) fn new(start: &super::Start) -> Self {
        let mut mean = All::zeros();
        let mut covariance = AllCovariance::zeros();
        for (place, (value, std)) in start.mean.iter().zip(start.std).enumerate() {
            mean[place] = *value;
            covariance[(place, place)] = std * std;
        }
        mean[HEADING] = wrap_rad(mean[HEADING]);
        Self {
            at: start.at,
            mean,
            covariance,
            keyframe: None,
            places_rejected: 0,
        }
    }

    pub(super) fn estimate(&self) -> Estimate {
        let key = pose(self.mean[KEY_X], self.mean[KEY_Y], self.mean[KEY_HEADING]);
        let here = pose(self.mean[X], self.mean[Y], self.mean[HEADING]);
        Estimate {
            at: self.at,
            mean: self.mean.fixed_rows::<STATES>(0).into_owned(),
            covariance: self
                .covariance
                .fixed_view::<STATES, STATES>(0, 0)
                .into_owned(),
            keyframe: self.keyframe.map(|at| (at, key.inverse() * here)),
        }
    }

    /// The belief at a later instant.
    pub(super) fn predicted(&self, at: Instant, noise: &Noise) -> Self {
        let mut belief = *self;
        let span_s = at.since_ns(self.at) as f64 * 1e-9;
        let steps = (span_s / STEP_MAX_S).ceil().min(STEPS_MAX);
        for _ in 0..steps as usize {
            belief.step(span_s / steps, noise);
        }
        belief.at = at;
        belief
    }

    /// One step of the prediction: acceleration and turning rate are constant, and the way
    /// is that of the step's middle.
    fn step(&mut self, step_s: f64, noise: &Noise) {
        let mean = &mut self.mean;
        let middle_rad = mean[HEADING] + mean[YAW_RATE] * step_s / 2.0;
        let (sin, cos) = middle_rad.sin_cos();
        let speed_mps = mean[SPEED] + mean[ACCEL] * step_s / 2.0;
        let way_m = speed_mps * step_s;
        mean[X] += way_m * cos;
        mean[Y] += way_m * sin;
        mean[HEADING] = wrap_rad(mean[HEADING] + mean[YAW_RATE] * step_s);
        mean[SPEED] += mean[ACCEL] * step_s;
        let mut by_state = AllCovariance::identity();
        for (place, way, aside_m) in [(X, cos, -way_m * sin), (Y, sin, way_m * cos)] {
            by_state[(place, HEADING)] = aside_m;
            by_state[(place, YAW_RATE)] = aside_m * step_s / 2.0;
            by_state[(place, SPEED)] = way * step_s;
            by_state[(place, ACCEL)] = way * step_s * step_s / 2.0;
        }
        by_state[(HEADING, YAW_RATE)] = step_s;
        by_state[(SPEED, ACCEL)] = step_s;
        self.covariance = by_state * self.covariance * by_state.transpose();
        self.add_changes((cos, sin, speed_mps), step_s, noise);
    }

    /// Adds the covariance of white noise in the derivatives of acceleration, turning rate
    /// and biases over a step: two chains of three integrators (Bar-Shalom et al., section
    /// 6.2.3), one along the heading and one aside, where the heading moves the place by
    /// the speed.
    fn add_changes(&mut self, (cos, sin, speed_mps): (f64, f64, f64), step_s: f64, noise: &Noise) {
        let powers = [1, 2, 3, 4, 5].map(|power| step_s.powi(power));
        // Covariances of the third integral, the second and the noise itself.
        let chain = Matrix3::new(
            powers[4] / 20.0,
            powers[3] / 8.0,
            powers[2] / 6.0,
            powers[3] / 8.0,
            powers[2] / 3.0,
            powers[1] / 2.0,
            powers[2] / 6.0,
            powers[1] / 2.0,
            powers[0],
        );
        let along = (
            [(X, cos), (Y, sin)],
            [SPEED, ACCEL],
            noise.accel_change.powi(2),
        );
        let aside = (
            [(X, -speed_mps * sin), (Y, speed_mps * cos)],
            [HEADING, YAW_RATE],
            noise.turn_change.powi(2),
        );
        for (places, [second, third], density) in [along, aside] {
            let rows = [
                (places[0].0, places[0].1, 0),
                (places[1].0, places[1].1, 0),
                (second, 1.0, 1),
                (third, 1.0, 2),
            ];
            for (row, times_row, k) in rows {
                for (column, times_column, l) in rows {
                    self.covariance[(row, column)] +=
                        density * times_row * times_column * chain[(k, l)];
                }
            }
        }
        self.covariance[(GYRO_BIAS, GYRO_BIAS)] += noise.gyro_bias_change.powi(2) * step_s;
        self.covariance[(ACCEL_BIAS, ACCEL_BIAS)] += noise.accel_bias_change.powi(2) * step_s;
    }

    /// Applies a measurement of this instant, or rejects it.
    pub(super) fn apply(
        &mut self,
        measurement: &Measurement,
        noise: &Noise,
        settings: &Settings,
    ) -> Verdict {
        match measurement {
            Measurement::Wheels {
                speed_mps,
                steer_rad,
            } => self.update(&self.wheels((*speed_mps, *steer_rad), noise, settings)),
            Measurement::Imu {
                yaw_rate_radps,
                accel_mps2,
            } => {
                let mut imu = Innovation::<2> {
                    residual: [
                        yaw_rate_radps - self.mean[YAW_RATE] - self.mean[GYRO_BIAS],
                        accel_mps2 - self.mean[ACCEL] - self.mean[ACCEL_BIAS],
                    ]
                    .into(),
                    by_state: SMatrix::zeros(),
                    noise: SMatrix::zeros(),
                    freedoms: 2,
                };
                for (row, place) in [(0, YAW_RATE), (0, GYRO_BIAS), (1, ACCEL), (1, ACCEL_BIAS)] {
                    imu.by_state[(row, place)] = 1.0;
                }
                imu.noise[(0, 0)] = noise.yaw_rate_radps.powi(2);
                imu.noise[(1, 1)] = noise.accel_mps2.powi(2);
                self.update(&imu)
            }
            Measurement::Motion {
                keyframe_from_body,
                information,
                ..
            } => self.update(&self.motion(keyframe_from_body, information)),
            Measurement::Place {
                world_from_body,
                information,
            } => self.place(world_from_body, information, settings),
            Measurement::Keyframe => self.keep(),
        }
    }

    /// Speed, and the turning rate that the bicycle has at this speed and steering angle. In
    /// this form a car that stands has a turning rate of 0; the angle itself would not be
    /// defined.
    fn wheels(
        &self,
        (speed_mps, steer_rad): (f64, Option<f64>),
        noise: &Noise,
        settings: &Settings,
    ) -> Innovation<2> {
        let wheelbase_m = settings.wheelbase_m;
        let mut wheels = Innovation::<2> {
            residual: [speed_mps - self.mean[SPEED], 0.0].into(),
            by_state: SMatrix::zeros(),
            noise: SMatrix::identity(),
            freedoms: 1,
        };
        wheels.by_state[(0, SPEED)] = 1.0;
        wheels.noise[(0, 0)] = noise.speed_mps.powi(2);
        if let Some(steer_rad) = steer_rad {
            let curvature_per_m = steer_rad.tan() / wheelbase_m;
            // d tan = d angle / cos².
            let turn = self.mean[SPEED] / (wheelbase_m * steer_rad.cos().powi(2));
            wheels.residual[1] = self.mean[SPEED] * curvature_per_m - self.mean[YAW_RATE];
            wheels.by_state[(1, YAW_RATE)] = 1.0;
            wheels.by_state[(1, SPEED)] = -curvature_per_m;
            wheels.noise[(1, 1)] = (turn * noise.steer_rad).powi(2) + noise.slip_radps.powi(2);
            wheels.freedoms = 2;
        }
        wheels
    }

    /// The pose in the frame of the keyframe.
    fn motion(&self, keyframe_from_body: &Pose, information: &Matrix3<f64>) -> Innovation<3> {
        let (sin, cos) = self.mean[KEY_HEADING].sin_cos();
        let dx_m = self.mean[X] - self.mean[KEY_X];
        let dy_m = self.mean[Y] - self.mean[KEY_Y];
        let (x_m, y_m) = (cos * dx_m + sin * dy_m, -sin * dx_m + cos * dy_m);
        let turn_rad = self.mean[HEADING] - self.mean[KEY_HEADING];
        let residual = difference(keyframe_from_body, &pose(x_m, y_m, turn_rad));
        let mut by_state = SMatrix::<f64, 3, ALL>::zeros();
        let places = [(X, Y, HEADING, 1.0), (KEY_X, KEY_Y, KEY_HEADING, -1.0)];
        for (x, y, heading, sign) in places {
            by_state[(0, x)] = sign * cos;
            by_state[(0, y)] = sign * sin;
            by_state[(1, x)] = -sign * sin;
            by_state[(1, y)] = sign * cos;
            by_state[(2, heading)] = sign;
        }
        by_state[(0, KEY_HEADING)] = y_m;
        by_state[(1, KEY_HEADING)] = -x_m;
        observed(&residual, &by_state, information)
    }

    /// The pose itself.
    fn place(
        &mut self,
        world_from_body: &Pose,
        information: &Matrix3<f64>,
        settings: &Settings,
    ) -> Verdict {
        let mut by_state = SMatrix::<f64, 3, ALL>::zeros();
        for (row, place) in [X, Y, HEADING].into_iter().enumerate() {
            by_state[(row, place)] = 1.0;
        }
        let here = pose(self.mean[X], self.mean[Y], self.mean[HEADING]);
        let residual = difference(world_from_body, &here);
        let innovation = observed(&residual, &by_state, information);
        let mut verdict = self.update(&innovation);
        let is_last = self.places_rejected >= settings.places_rejected_max;
        if !verdict.is_applied && is_last && verdict.nis.is_finite() {
            self.covariance *= verdict.nis / gate(verdict.freedoms);
            verdict.is_applied = self.correct(&innovation);
        }
        self.places_rejected = match verdict.is_applied {
            true => 0,
            false => self.places_rejected.saturating_add(1),
        };
        verdict
    }

    /// Copies the pose to the keyframe's.
    fn keep(&mut self) -> Verdict {
        let mut copy = AllCovariance::identity();
        for (key, place) in [(KEY_X, X), (KEY_Y, Y), (KEY_HEADING, HEADING)] {
            copy[(key, key)] = 0.0;
            copy[(key, place)] = 1.0;
        }
        self.mean = copy * self.mean;
        self.covariance = copy * self.covariance * copy.transpose();
        self.keyframe = Some(self.at);
        Verdict {
            nis: 0.0,
            freedoms: 0,
            is_applied: true,
        }
    }

    /// Applies an innovation, unless its gate rejects it.
    fn update<const M: usize>(&mut self, innovation: &Innovation<M>) -> Verdict {
        let nis = self.nis(innovation);
        // False for NaN, too.
        let is_inside = nis <= gate(innovation.freedoms);
        Verdict {
            nis,
            freedoms: innovation.freedoms,
            is_applied: is_inside && self.correct(innovation),
        }
    }

    /// The covariance of an innovation.
    fn spread<const M: usize>(&self, innovation: &Innovation<M>) -> SMatrix<f64, M, M> {
        let by_state = &innovation.by_state;
        by_state * self.covariance * by_state.transpose() + innovation.noise
    }

    /// Normalised innovation squared; infinite when the covariance has no inverse.
    fn nis<const M: usize>(&self, innovation: &Innovation<M>) -> f64 {
        let residual = &innovation.residual;
        let inverse = self.spread(innovation).cholesky();
        inverse.map_or(f64::INFINITY, |it| residual.dot(&it.solve(residual)))
    }

    /// The update of the Kalman filter, in Joseph's form, which keeps the covariance
    /// positive (Bar-Shalom et al., section 5.2.3). Returns whether there is one.
    fn correct<const M: usize>(&mut self, innovation: &Innovation<M>) -> bool {
        let Innovation {
            residual,
            by_state,
            noise,
            ..
        } = innovation;
        let Some(inverse) = self.spread(innovation).cholesky() else {
            return false;
        };
        let gain = inverse.solve(&(by_state * self.covariance)).transpose();
        self.mean += gain * residual;
        self.mean[HEADING] = wrap_rad(self.mean[HEADING]);
        self.mean[KEY_HEADING] = wrap_rad(self.mean[KEY_HEADING]);
        let rest = AllCovariance::identity() - gain * by_state;
        let joseph = rest * self.covariance * rest.transpose() + gain * noise * gain.transpose();
        self.covariance = (joseph + joseph.transpose()) / 2.0;
        true
    }
}

/// Greatest NIS of so many numbers that is applied.
fn gate(freedoms: usize) -> f64 {
    GATE[freedoms.clamp(1, GATE.len()) - 1]
}

/// A pose minus another: x, y, and the heading wrapped.
fn difference(measured: &Pose, predicted: &Pose) -> Vector3<f64> {
    let place = measured.translation.vector - predicted.translation.vector;
    let turn_rad = measured.rotation.angle() - predicted.rotation.angle();
    Vector3::new(place.x, place.y, wrap_rad(turn_rad))
}

/// The part of a pose that its information observes: along each eigenvector, with the
/// eigenvalue's inverse as variance.
fn observed(
    residual: &Vector3<f64>,
    by_state: &SMatrix<f64, 3, ALL>,
    information: &Matrix3<f64>,
) -> Innovation<3> {
    let eigen = information.symmetric_eigen();
    let least = eigen.eigenvalues.max() * INFORMATION_MIN;
    let mut turned = Innovation {
        residual: eigen.eigenvectors.transpose() * residual,
        by_state: eigen.eigenvectors.transpose() * by_state,
        noise: Matrix3::identity(),
        freedoms: 3,
    };
    for (row, eigenvalue) in eigen.eigenvalues.iter().enumerate() {
        if *eigenvalue > least {
            turned.noise[(row, row)] = 1.0 / eigenvalue;
        } else {
            turned.residual[row] = 0.0;
            turned.by_state.row_mut(row).fill(0.0);
            turned.freedoms -= 1;
        }
    }
    turned
}
