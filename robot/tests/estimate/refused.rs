//! What the filter refuses: no measurement, too late, twice, out of order, too much.

use nalgebra::{Matrix3, Vector3};
use robot::estimate::{EstimateError, Filter, HISTORY, Measurement, Noise, Settings, Start};
use shm_config::Instant;
use vehicle::pose;

use super::simulated::{IMU_NS, filter, start};

pub fn imu(yaw_rate_radps: f64, accel_mps2: f64) -> Measurement {
    Measurement::Imu {
        yaw_rate_radps,
        accel_mps2,
    }
}

pub fn place(x_m: f64, information: Matrix3<f64>) -> Measurement {
    Measurement::Place {
        world_from_body: pose(x_m, 0.0, 0.0),
        information,
    }
}

#[test]
fn what_no_sensor_measures_is_refused_and_changes_nothing() {
    let mut filter = filter(1.0);
    let at = Instant(IMU_NS);
    filter.add(at, at, imu(0.1, 0.0)).expect("it is taken");
    let before = filter.estimate(at).expect("of now");
    let now = Instant(2 * IMU_NS);
    let wheels = |speed_mps, steer_rad| Measurement::Wheels {
        speed_mps,
        steer_rad,
    };
    let skew = Matrix3::new(1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0);
    let negative = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    let mut holed = Matrix3::identity();
    holed[(1, 1)] = f64::NAN;
    let bad = [
        imu(f64::NAN, 0.0),
        imu(0.0, f64::INFINITY),
        imu(1e3, 0.0),
        wheels(f64::NEG_INFINITY, None),
        wheels(200.0, None),
        wheels(1.0, Some(f64::NAN)),
        wheels(1.0, Some(1.5)),
        place(f64::NAN, Matrix3::identity()),
        place(1e7, Matrix3::identity()),
        place(0.0, Matrix3::zeros()),
        place(0.0, Matrix3::identity() * 1e30),
        place(0.0, skew),
        place(0.0, negative),
        place(0.0, holed),
    ];
    for measurement in bad {
        let refused = filter.add(now, now, measurement);
        let is_named = matches!(
            refused,
            Err(EstimateError::Value { .. } | EstimateError::Information)
        );
        assert!(is_named, "{measurement:?}: {refused:?}");
    }
    assert_eq!(filter.counts().refused, bad.len() as u64);
    let after = filter.estimate(at).expect("of then");
    assert_eq!(after, before);
}

#[test]
fn what_is_of_the_future_too_late_twice_or_out_of_order_is_refused() {
    let mut filter = filter(1.0);
    let second = 1_000_000_000;
    let motion = |since| Measurement::Motion {
        since: Instant(since),
        keyframe_from_body: pose(0.1, 0.0, 0.0),
        information: Matrix3::identity(),
    };
    let key = Measurement::Keyframe;
    let mut add = |now, taken, measurement| filter.add(Instant(now), Instant(taken), measurement);
    assert_eq!(
        add(second, second, imu(0.1, 0.0)).map(|it| it.freedoms),
        Ok(2)
    );
    let (now, taken) = (Instant(second), Instant(second + 1));
    let future = add(second, second + 1, imu(0.1, 0.0));
    assert_eq!(future, Err(EstimateError::Future { taken, now }));
    let twice = add(second, second, imu(0.2, 0.0));
    assert_eq!(twice, Err(EstimateError::Duplicate { taken: now }));
    let back = add(second - 1, second - 1, imu(0.1, 0.0));
    let (earlier, newest) = (Instant(second - 1), Instant(second));
    assert_eq!(
        back,
        Err(EstimateError::Clock {
            now: earlier,
            newest
        })
    );
    // Half a second is accepted, and not a nanosecond more.
    assert!(add(second, second / 2, imu(0.1, 0.0)).is_ok());
    let (taken, oldest) = (Instant(second / 2 - 1), Instant(second / 2));
    let late = add(second, second / 2 - 1, imu(0.1, 0.0));
    assert_eq!(late, Err(EstimateError::Late { taken, oldest }));
    // Scans come in order, and each motion since its own keyframe.
    let alone = add(second, second, motion(second / 2));
    let since = Instant(second / 2);
    assert_eq!(alone, Err(EstimateError::Keyframe { since }));
    assert!(add(second, second / 2 + 10, key).is_ok());
    assert!(add(second, second, motion(second / 2 + 10)).is_ok());
    let taken = Instant(second / 2 + 20);
    let between = add(second, second / 2 + 20, key);
    assert_eq!(between, Err(EstimateError::OutOfOrder { taken }));
    assert_eq!(filter.counts().late, 1);
    assert_eq!(filter.counts().refused, 5);
    // Nothing before the history is known.
    let long_ago = filter.estimate(Instant(0));
    assert!(
        long_ago.is_ok(),
        "the start is still the base: {long_ago:?}"
    );
    filter
        .add(Instant(3 * second), Instant(3 * second), key)
        .expect("it is taken");
    let long_ago = filter.estimate(Instant(0));
    assert!(
        matches!(long_ago, Err(EstimateError::Late { .. })),
        "{long_ago:?}"
    );
}

#[test]
fn a_full_history_is_an_error_and_passes() {
    let mut filter = filter(1.0);
    let now = Instant(HISTORY as u64 + 10);
    for k in 1..=HISTORY as u64 {
        assert!(filter.add(now, Instant(k), imu(0.1, 0.0)).is_ok(), "{k}");
    }
    assert_eq!(
        filter.add(now, now, imu(0.1, 0.0)),
        Err(EstimateError::Full)
    );
    let later = Instant(1_000_000_000);
    assert!(filter.add(later, later, imu(0.1, 0.0)).is_ok());
}

#[test]
fn settings_that_make_no_sense_are_refused_by_name() {
    let refused = |settings: Settings, noise: Noise, start: Start| match Filter::new(
        &settings, &noise, &start,
    ) {
        Err(EstimateError::Setting { name, .. }) => name,
        other => panic!("{:?}", other.map(|_| ())),
    };
    let (settings, noise, start) = (Settings::default(), Noise::default(), start());
    let delay_s = f64::NAN;
    assert_eq!(
        refused(
            Settings {
                delay_s,
                ..settings
            },
            noise,
            start
        ),
        "delay_s"
    );
    let wheelbase_m = 0.0;
    let short = Settings {
        wheelbase_m,
        ..settings
    };
    assert_eq!(refused(short, noise, start), "wheelbase_m");
    let speed_mps = 0.0;
    let exact = Noise { speed_mps, ..noise };
    assert_eq!(refused(settings, exact, start), "speed_mps");
    let mut unknown = start;
    unknown.mean[2] = f64::INFINITY;
    assert_eq!(refused(settings, noise, unknown), "start");
    let mut sure = start;
    sure.std[2] = 0.0;
    assert_eq!(refused(settings, noise, sure), "the start's deviation");
}
