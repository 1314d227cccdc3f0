//! The meaning of the policy's input is pinned, because weights are trained for it.

use shm_config::message::{
    Bend, Checkpoint, Ego, FEATURES, FEATURES_VERSION, OBSERVATION_LAYOUT, Observation, Road,
};

fn observation() -> Observation {
    let checkpoint = |x_body_m, bend: Bend| Checkpoint {
        x_body_m,
        y_body_m: -3.0,
        bend_radius_m: 20.0,
        bend_angle_rad: 0.5,
        bend: bend.code(),
        reserved: 0,
    };
    let mut observation = Observation {
        ego: Ego {
            x_world_m: 1.0,
            y_world_m: 2.0,
            heading_world_rad: 3.0,
            speed_mps: 5.0,
            yaw_rate_radps: -0.125,
            steer: 0.5,
            pedal: -0.25,
        },
        road: Road {
            left_m: 4.5,
            right_m: 9.0,
            heading_rad: 0.25,
            offset_m: -0.75,
            lane_width_m: 3.5,
        },
        checkpoints: [
            checkpoint(10.0, Bend::Left),
            checkpoint(100.0, Bend::Straight),
        ],
        lidar_max_m: 50.0,
        beam_count: 240,
        ..Observation::default()
    };
    for (k, range_m) in observation.ranges_m[..240].iter_mut().enumerate() {
        *range_m = k as f32 * 0.2;
    }
    observation
}

/// When this fails because the meaning of a feature has changed, raise
/// [`FEATURES_VERSION`] and update the numbers here: nets that were trained for the
/// old meaning are then refused instead of driving badly.
#[test]
fn the_meaning_of_the_features_is_pinned() {
    let mut out = [0.0; FEATURES];
    let observation = observation();
    let features = observation.features(&mut out).expect("there is room");
    assert_eq!(FEATURES_VERSION, 1);
    let expected = include_str!("features.txt");
    let found: Vec<String> = features[..19].iter().map(|f| format!("{f:.6}")).collect();
    assert_eq!(found.join(" "), expected.trim());
    for (k, feature) in features[19..].iter().enumerate() {
        assert!(
            (feature - k as f32 * 0.004).abs() < 1e-6,
            "beam {k}: {feature}"
        );
    }
    assert_eq!(format!("{OBSERVATION_LAYOUT:016x}"), "da69ea6a42d322c0");
}
