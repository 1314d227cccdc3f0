//! Sensors with noise, biases, delay and losses.

use robot::Point;
use robot::estimate::{Measurement, Noise};
use shm_config::Instant;

use crate::dice::Dice;
use crate::options::Options;

/// Noise of one range, m, at `VLAPS_NOISE=1`.
const RANGE_STD_M: f64 = 0.02;
/// Biases of gyroscope, rad/s, and accelerometer, m/s², drawn for each episode, at
/// `VLAPS_NOISE=1`.
pub const GYRO_BIAS_STD: f64 = 0.01;
pub const ACCEL_BIAS_STD: f64 = 0.1;
/// The filter never believes in less noise than this share of that at `VLAPS_NOISE=1`.
const NOISE_MIN: f64 = 0.2;

/// What a sensor sends.
pub enum Message {
    Motion(Measurement),
    /// The ranges of all beams, m.
    Scan(Vec<f64>),
}

/// How the car moves at an instant.
#[derive(Clone, Copy)]
pub struct Motion {
    pub speed_mps: f64,
    pub yaw_rate_radps: f64,
    pub accel_mps2: f64,
    pub steer_rad: f64,
}

pub struct Sensors {
    dice: Dice,
    options: Options,
    gyro_bias_radps: f64,
    accel_bias_mps2: f64,
    /// On the way: when each arrives, and when it was taken.
    sent: Vec<(Instant, Instant, Message)>,
}

impl Sensors {
    pub fn new(seed: u64, options: Options) -> Self {
        let mut dice = Dice::new(seed);
        Self {
            gyro_bias_radps: options.noise * GYRO_BIAS_STD * dice.normal(),
            accel_bias_mps2: options.noise * ACCEL_BIAS_STD * dice.normal(),
            dice,
            options,
            sent: Vec::new(),
        }
    }

    /// What the filter is told of the noise.
    pub fn noise(&self) -> Noise {
        let (noise, times) = (Noise::default(), self.options.noise.max(NOISE_MIN));
        Noise {
            turn_change: noise.turn_change,
            accel_change: noise.accel_change,
            ..noise.times(times)
        }
    }

    /// Noise of a range that the alignment is told, m.
    pub fn range_std_m(&self) -> f64 {
        RANGE_STD_M * self.options.noise.max(NOISE_MIN)
    }

    fn off(&mut self, std: f64) -> f64 {
        self.options.noise * std * self.dice.normal()
    }

    fn send(&mut self, now: Instant, message: Message) {
        // Both are drawn for each message, so that other messages do not change with them.
        let (delay, fate) = (0.5 + self.dice.unit(), self.dice.unit());
        let delay_ns = (delay * self.options.delay_s * 1e9) as u64;
        if fate >= self.options.drop {
            self.sent.push((now.after_ns(delay_ns), now, message));
        }
    }

    /// Wheels and IMU measure.
    pub fn feel(&mut self, now: Instant, motion: Motion) {
        let noise = Noise::default();
        let wheels = Measurement::Wheels {
            speed_mps: motion.speed_mps + self.off(noise.speed_mps),
            steer_rad: Some(motion.steer_rad + self.off(noise.steer_rad)),
        };
        let gyro_radps = self.gyro_bias_radps + self.off(noise.yaw_rate_radps);
        let imu = Measurement::Imu {
            yaw_rate_radps: motion.yaw_rate_radps + gyro_radps,
            accel_mps2: motion.accel_mps2 + self.accel_bias_mps2 + self.off(noise.accel_mps2),
        };
        self.send(now, Message::Motion(wheels));
        self.send(now, Message::Motion(imu));
    }

    /// The scanner measures these ranges, m.
    pub fn look(&mut self, now: Instant, ranges_m: impl Iterator<Item = f64>) {
        let ranges_m = ranges_m.map(|range_m| range_m + self.off(RANGE_STD_M));
        let ranges_m = ranges_m.collect();
        self.send(now, Message::Scan(ranges_m));
    }

    /// What has arrived, in the order of its arrival, with the instant it was taken.
    pub fn arrived(&mut self, now: Instant) -> Vec<(Instant, Message)> {
        let (mut arrived, waiting): (Vec<_>, Vec<_>) = self
            .sent
            .drain(..)
            .partition(|(arrives, ..)| *arrives <= now);
        self.sent = waiting;
        arrived.sort_by_key(|(arrives, ..)| *arrives);
        let arrived = arrived.into_iter();
        arrived
            .map(|(_, taken, message)| (taken, message))
            .collect()
    }
}

/// The points of a scan as a line from beam to beam: between two beams nothing is free.
pub fn points(fan: &vehicle::Fan, ranges_m: &[f64]) -> Vec<Point> {
    let mut points: Vec<Point> = ranges_m
        .iter()
        .enumerate()
        .map(|(beam, range_m)| fan.point_body(beam, *range_m))
        .collect();
    if fan.is_circle() {
        points.extend(points.first().copied());
    }
    points
}
