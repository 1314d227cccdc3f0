//! The motion of a car from wheels, IMU and scan, where the world has no truth to publish.
//!
//! | type | is |
//! |---|---|
//! | [`Filter`] | an extended Kalman filter over time-stamped, late and missing measurements |
//! | [`Measurement`] | what it takes: wheels, IMU, keyframe, motion, place |
//! | [`Estimate`] | what it answers: eight numbers at an instant, and their covariance |
//! | [`Outline`], [`align()`] | the motion between two scans, with its information |
//!
//! The state is x, y (m, frame `world`), heading (rad, counter-clockwise), speed (m/s, along
//! the heading), turning rate (rad/s), acceleration (m/s², along the heading), and the biases
//! of gyroscope (rad/s) and accelerometer (m/s²). Between two measurements turning rate and
//! acceleration are constant but for white noise in their derivatives (Li and Jilkov, *Survey
//! of Maneuvering Target Tracking. Part I*, IEEE T-AES 39(4), 2003: constant turn rate and
//! acceleration). The angle of the front wheels enters as a measurement of the turning rate
//! by the kinematic bicycle ([`vehicle::step`]). Side slip, slopes and a scale error of the
//! wheels are not modelled.
//!
//! A copy of the pose at the newest keyframe is part of the state, so that the motion between
//! two scans is a measurement with its correlations (Roumeliotis and Burdick, *Stochastic
//! Cloning*, ICRA 2002). Scan noise that two successive motions share is not modelled.
//!
//! Gates, NIS and NEES are those of Bar-Shalom, Li and Kirubarajan, *Estimation with
//! Applications to Tracking and Navigation*, 2001, section 5.4. `robot/tests/estimate.rs`
//! tests that the covariance is the one of the errors.
//!
//! ```
//! use robot::estimate::{Filter, Measurement, Noise, SPEED, Settings, Start};
//! use shm_config::Instant;
//!
//! # fn main() -> Result<(), robot::estimate::EstimateError> {
//! // A start that is wrong by many of its deviations would reject the wheels.
//! let mut start = Start::default();
//! start.mean[SPEED] = 2.0;
//! let mut filter = Filter::new(&Settings::default(), &Noise::default(), &start)?;
//! for tick in 1..=100_u64 {
//!     let now = Instant(tick * 20_000_000);
//!     // The IMU answers 40 ms late: its first data would be older than the filter.
//!     let taken = Instant(now.0.saturating_sub(40_000_000));
//!     let wheels = Measurement::Wheels { speed_mps: 2.0, steer_rad: Some(0.0) };
//!     filter.add(now, now, wheels)?;
//!     let imu = Measurement::Imu { yaw_rate_radps: 0.0, accel_mps2: 0.0 };
//!     if tick > 2 {
//!         filter.add(now, taken, imu)?;
//!     }
//! }
//! let estimate = filter.estimate(Instant(2_000_000_000))?;
//! assert!((estimate.speed_mps() - 2.0).abs() < 0.2);
//! # Ok(())
//! # }
//! ```

mod align;
mod belief;
mod error;
mod filter;
mod measurement;
mod outline;
mod settings;

pub use align::{Aligned, Unaligned, align};
pub use belief::{Covariance, Estimate, Mean, Verdict};
pub use error::EstimateError;
pub use filter::{Counts, Filter, HISTORY};
pub use measurement::Measurement;
pub use outline::Outline;
pub use settings::{GATE, Noise, Settings, Start};

/// Numbers of the state: their places in [`Estimate::mean`] and its covariance.
pub const STATES: usize = 8;
/// Position in the world, m.
pub const X: usize = 0;
/// Position in the world, m.
pub const Y: usize = 1;
/// Heading in the world, rad, counter-clockwise, wrapped.
pub const HEADING: usize = 2;
/// Speed along the heading, m/s.
pub const SPEED: usize = 3;
/// Turning rate, rad/s, counter-clockwise.
pub const YAW_RATE: usize = 4;
/// Acceleration along the heading, m/s².
pub const ACCEL: usize = 5;
/// What the gyroscope adds to the turning rate, rad/s.
pub const GYRO_BIAS: usize = 6;
/// What the accelerometer adds to the acceleration, m/s².
pub const ACCEL_BIAS: usize = 7;
