//! A car that moves as the filter assumes, and sensors with the noise that it assumes.

use nalgebra::{Matrix3, Vector3};
use robot::estimate::{
    ACCEL, ACCEL_BIAS, Counts, Filter, GYRO_BIAS, HEADING, Mean, Measurement, Noise, SPEED, STATES,
    Settings, Start, Verdict, X, Y, YAW_RATE,
};
use robot::wrap_rad;
use shm_config::Instant;
use vehicle::{Pose, pose};

use crate::dice::Dice;

/// The truth moves in steps of this.
const STEP_NS: u64 = 1_000_000;
pub const IMU_NS: u64 = 20_000_000;
const WHEELS_NS: u64 = 40_000_000;
const SCAN_NS: u64 = 100_000_000;
const PLACE_NS: u64 = 500_000_000;
pub const TICK_NS: u64 = 100_000_000;
/// Standard deviations of the motion between scans and of the place on a map: m, m, rad.
const MOTION_STD: [f64; 3] = [0.02, 0.02, 0.005];
const PLACE_STD: [f64; 3] = [0.2, 0.2, 0.03];

/// A car that changes its motion by so much that ten seconds lead far, and not so much that
/// it drives backwards.
pub fn noise() -> Noise {
    Noise {
        turn_change: 0.05,
        accel_change: 0.1,
        gyro_bias_change: 1e-3,
        accel_bias_change: 1e-2,
        ..Noise::default()
    }
}

pub fn start() -> Start {
    Start {
        mean: [3.0, -2.0, 0.5, 10.0, 0.1, 0.0, 0.0, 0.0],
        std: [0.3, 0.3, 0.05, 0.3, 0.05, 0.2, 0.02, 0.2],
        ..Start::default()
    }
}

/// A measurement with the instant it was taken.
#[derive(Clone, Copy, Debug)]
pub struct Taken {
    pub at: Instant,
    pub measurement: Measurement,
}

/// A drive: what was measured, in the order of time, and the truth at each tick.
pub struct Drive {
    pub taken: Vec<Taken>,
    pub truth: Vec<(Instant, Mean)>,
}

fn pose_of(truth: &Mean) -> Pose {
    pose(truth[X], truth[Y], truth[HEADING])
}

/// A pose with an error of these deviations, and the information of it.
fn blurred(dice: &mut Dice, truth: &Pose, std: [f64; 3]) -> (Pose, Matrix3<f64>) {
    let at = truth.translation.vector;
    let measured = pose(
        at.x + std[0] * dice.normal(),
        at.y + std[1] * dice.normal(),
        truth.rotation.angle() + std[2] * dice.normal(),
    );
    let information = Vector3::from(std).map(|std| 1.0 / (std * std));
    (measured, Matrix3::from_diagonal(&information))
}

impl Drive {
    pub fn new(seed: u64, duration_s: f64) -> Self {
        let (mut dice, noise, start) = (Dice::new(seed), noise(), start());
        let mut truth = Mean::zeros();
        for place in 0..STATES {
            truth[place] = start.mean[place] + start.std[place] * dice.normal();
        }
        let mut keyframe = pose_of(&truth);
        let mut drive = Self {
            taken: vec![Taken {
                at: start.at,
                measurement: Measurement::Keyframe,
            }],
            truth: Vec::new(),
        };
        let steps = (duration_s * 1e9) as u64 / STEP_NS;
        for step in 1..=steps {
            move_on(&mut truth, &noise, &mut dice);
            let at_ns = step * STEP_NS;
            drive.measure(at_ns, &truth, &mut keyframe, &mut dice);
            if at_ns.is_multiple_of(TICK_NS) {
                drive.truth.push((Instant(at_ns), truth));
            }
        }
        drive
    }

    fn measure(&mut self, at_ns: u64, truth: &Mean, keyframe: &mut Pose, dice: &mut Dice) {
        let noise = noise();
        let mut take = |measurement| {
            self.taken.push(Taken {
                at: Instant(at_ns),
                measurement,
            });
        };
        if at_ns.is_multiple_of(WHEELS_NS) {
            let rolled_radps = truth[YAW_RATE] + noise.slip_radps * dice.normal();
            let wheelbase_m = Settings::default().wheelbase_m;
            let steer_rad = (wheelbase_m * rolled_radps / truth[SPEED]).atan();
            take(Measurement::Wheels {
                speed_mps: truth[SPEED] + noise.speed_mps * dice.normal(),
                steer_rad: Some(steer_rad + noise.steer_rad * dice.normal()),
            });
        }
        if at_ns.is_multiple_of(IMU_NS) {
            let yaw_rate_radps = truth[YAW_RATE] + truth[GYRO_BIAS];
            let accel_mps2 = truth[ACCEL] + truth[ACCEL_BIAS];
            take(Measurement::Imu {
                yaw_rate_radps: yaw_rate_radps + noise.yaw_rate_radps * dice.normal(),
                accel_mps2: accel_mps2 + noise.accel_mps2 * dice.normal(),
            });
        }
        if at_ns.is_multiple_of(SCAN_NS) {
            let motion = keyframe.inverse() * pose_of(truth);
            let (keyframe_from_body, information) = blurred(dice, &motion, MOTION_STD);
            take(Measurement::Motion {
                since: Instant(at_ns - SCAN_NS),
                keyframe_from_body,
                information,
            });
            take(Measurement::Keyframe);
            *keyframe = pose_of(truth);
        }
        if at_ns.is_multiple_of(PLACE_NS) {
            let (world_from_body, information) = blurred(dice, &pose_of(truth), PLACE_STD);
            take(Measurement::Place {
                world_from_body,
                information,
            });
        }
    }
}

/// One step of the truth: white noise in the derivatives of acceleration, turning rate and
/// biases.
fn move_on(truth: &mut Mean, noise: &Noise, dice: &mut Dice) {
    let step_s = STEP_NS as f64 * 1e-9;
    let middle_rad = truth[HEADING] + truth[YAW_RATE] * step_s / 2.0;
    let way_m = (truth[SPEED] + truth[ACCEL] * step_s / 2.0) * step_s;
    truth[X] += way_m * middle_rad.cos();
    truth[Y] += way_m * middle_rad.sin();
    truth[HEADING] = wrap_rad(truth[HEADING] + truth[YAW_RATE] * step_s);
    truth[SPEED] += truth[ACCEL] * step_s;
    let changes = [
        (YAW_RATE, noise.turn_change),
        (ACCEL, noise.accel_change),
        (GYRO_BIAS, noise.gyro_bias_change),
        (ACCEL_BIAS, noise.accel_bias_change),
    ];
    for (place, change) in changes {
        truth[place] += change * step_s.sqrt() * dice.normal();
    }
}

/// A measurement with the noise that a filter is told multiplied: its own information
/// follows.
pub fn told(measurement: Measurement, factor: f64) -> Measurement {
    let times = 1.0 / (factor * factor);
    match measurement {
        Measurement::Motion {
            since,
            keyframe_from_body,
            information,
        } => Measurement::Motion {
            since,
            keyframe_from_body,
            information: information * times,
        },
        Measurement::Place {
            world_from_body,
            information,
        } => Measurement::Place {
            world_from_body,
            information: information * times,
        },
        other => other,
    }
}

pub fn filter(factor: f64) -> Filter {
    Filter::new(&Settings::default(), &noise().times(factor), &start()).expect("a filter")
}

/// What a filter that takes all measurements in order says at each tick.
pub struct Filtered {
    /// NEES at each tick.
    pub nees: Vec<f64>,
    pub verdicts: Vec<(Measurement, Verdict)>,
    pub counts: Counts,
}

/// Filters a drive, with the noise that the filter is told multiplied.
pub fn filtered(drive: &Drive, factor: f64) -> Filtered {
    let mut filter = filter(factor);
    let mut taken = drive.taken.iter().peekable();
    let (mut nees, mut verdicts) = (Vec::new(), Vec::new());
    for (at, truth) in &drive.truth {
        while let Some(next) = taken.next_if(|next| next.at <= *at) {
            let measurement = told(next.measurement, factor);
            let verdict = filter.add(next.at, next.at, measurement);
            verdicts.push((measurement, verdict.expect("it is taken")));
        }
        let estimate = filter.estimate(*at).expect("of now");
        nees.push(estimate.nees(truth).expect("a covariance"));
    }
    Filtered {
        nees,
        verdicts,
        counts: filter.counts(),
    }
}
