//! Tests of the checks of all messages, field by field.

use proptest::prelude::*;
use shm_config::message::*;
use shm_config::{Instant, Message};

const NOW: Instant = Instant(10_000_000_000);
const LIMIT_NS: u64 = 100_000_000;

fn observation() -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    observation.header.taken_ns = NOW.0;
    observation
}

fn refused<M: Message>(good: M, spoil: impl Fn(&mut M)) -> Refusal {
    assert_eq!(good.check(), Ok(()), "{good:?} is good before it is spoilt");
    let mut bad = good;
    spoil(&mut bad);
    bad.check().expect_err("refused")
}

#[test]
fn observations() {
    let nan = f64::NAN;
    type Set = fn(&mut Observation, f64);
    let fields: [(&str, Set); 16] = [
        ("ego.x_world_m", |o, v| o.ego.x_world_m = v),
        ("ego.y_world_m", |o, v| o.ego.y_world_m = v),
        ("ego.heading_world_rad", |o, v| o.ego.heading_world_rad = v),
        ("ego.speed_mps", |o, v| o.ego.speed_mps = v),
        ("ego.yaw_rate_radps", |o, v| o.ego.yaw_rate_radps = v),
        ("ego.steer", |o, v| o.ego.steer = v),
        ("road.left_m", |o, v| o.road.left_m = v),
        ("road.heading_rad", |o, v| o.road.heading_rad = v),
        ("checkpoint.x_body_m", |o, v| o.checkpoints[1].x_body_m = v),
        ("lidar_max_m", |o, v| o.lidar_max_m = v as f32),
        ("road.lane_width_m", |o, v| o.road.lane_width_m = v),
        ("field_of_view_rad", |o, v| o.field_of_view_rad = v),
        ("scanner_heading_rad", |o, v| o.scanner_heading_rad = v),
        ("scanner_x_body_m", |o, v| o.scanner_x_body_m = v),
        ("scanner_y_body_m", |o, v| o.scanner_y_body_m = v),
        ("ranges_m", |o, v| o.ranges_m[239] = v as f32),
    ];
    for (field, set) in fields {
        for value in [nan, f64::INFINITY, f64::NEG_INFINITY] {
            let refusal = refused(observation(), |o| set(o, value));
            assert_eq!(refusal, Refusal::NotFinite { field }, "{value}");
        }
        let refusal = refused(observation(), |o| set(o, 1e30));
        assert!(
            matches!(refusal, Refusal::OutOfRange { field: f, .. } if f == field),
            "{refusal}"
        );
    }
}

#[test]
fn counts_and_limits_of_observations() {
    let refusal = refused(observation(), |o| o.beam_count = 2049);
    assert_eq!(
        refusal,
        Refusal::OverCapacity {
            field: "beam_count",
            count: 2049,
            capacity: 2048
        }
    );
    let refusal = refused(observation(), |o| o.ranges_m[0] = -0.1);
    assert!(matches!(
        refusal,
        Refusal::OutOfRange {
            field: "ranges_m",
            ..
        }
    ));
    let refusal = refused(observation(), |o| o.checkpoints[0].bend = 3);
    assert_eq!(
        refusal,
        Refusal::UnknownCode {
            field: "checkpoint.bend",
            code: 3
        }
    );
    let mut least = observation();
    (least.ranges_m[0], least.ranges_m[1]) = (-0.0, least.lidar_max_m);
    assert_eq!(least.check(), Ok(()), "both ends of the range");
    let mut hidden = observation();
    hidden.ranges_m[240] = f32::NAN;
    assert_eq!(
        hidden.check(),
        Ok(()),
        "beams beyond the count do not count"
    );
    let empty = Observation {
        beam_count: 0,
        ..observation()
    };
    assert_eq!(empty.check(), Ok(()), "a world without lidar is a world");
}

#[test]
fn plans() {
    let mut plan = Plan {
        waypoint_count: 2,
        ..Plan::default()
    };
    plan.header.taken_ns = NOW.0;
    assert!(matches!(
        refused(plan, |p| p.waypoint_count = 65),
        Refusal::OverCapacity { .. }
    ));
    assert!(matches!(
        refused(plan, |p| p.waypoints[1].y_body_m = f64::NAN),
        Refusal::NotFinite { .. }
    ));
    assert!(matches!(
        refused(plan, |p| p.action_count = 33),
        Refusal::OverCapacity { .. }
    ));
    assert!(matches!(
        refused(plan, |p| p.action_count = 1),
        Refusal::OutOfRange { .. }
    ));
    let acting = |p: &mut Plan, steer| {
        (p.action_count, p.action_step_s) = (1, 0.1);
        p.actions[0].steer = steer;
    };
    assert!(matches!(
        refused(plan, |p| acting(p, f64::NAN)),
        Refusal::NotFinite { .. }
    ));
    assert!(matches!(
        refused(plan, |p| acting(p, 1.5)),
        Refusal::OutOfRange { .. }
    ));
    assert!(matches!(
        refused(plan, |p| p.waypoints[0].speed_mps = -1.0),
        Refusal::OutOfRange { .. }
    ));
    assert!(matches!(
        refused(plan, |p| p.outcome = 3),
        Refusal::UnknownCode { .. }
    ));
    assert!(matches!(
        refused(plan, |p| p.lateness = 4),
        Refusal::UnknownCode { .. }
    ));
    assert!(matches!(
        refused(plan, |p| p.cost_m = -1.0),
        Refusal::OutOfRange { .. }
    ));
}

#[test]
fn commands_and_advice() {
    let command = Step::default().command;
    assert!(matches!(
        refused(command, |c| c.steer = 1.0 + 1e-9),
        Refusal::OutOfRange { .. }
    ));
    assert!(matches!(
        refused(command, |c| c.pedal = f64::NAN),
        Refusal::NotFinite { .. }
    ));
    assert!(matches!(
        refused(command, |c| c.driver = 3),
        Refusal::UnknownCode { .. }
    ));
    assert!(matches!(
        refused(command, |c| c.reason = 99),
        Refusal::UnknownCode { .. }
    ));

    assert!(matches!(
        refused(Advice::default(), |a| a.preference = 3),
        Refusal::UnknownCode { .. }
    ));
    assert!(matches!(
        refused(Advice::default(), |a| a.judge = 77),
        Refusal::UnknownCode { .. }
    ));
}

#[test]
fn takeovers() {
    for active in [0, 1] {
        let takeover = Takeover {
            active,
            ..Takeover::default()
        };
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let field = "steer";
            let refusal = refused(takeover, |t| t.steer = value);
            assert_eq!(refusal, Refusal::NotFinite { field });
            let field = "pedal";
            let refusal = refused(takeover, |t| t.pedal = value);
            assert_eq!(refusal, Refusal::NotFinite { field });
        }
        assert!(matches!(
            refused(takeover, |t| t.steer = 1.0 + 1e-9),
            Refusal::OutOfRange { field: "steer", .. }
        ));
        assert!(matches!(
            refused(takeover, |t| t.pedal = -1.5),
            Refusal::OutOfRange { field: "pedal", .. }
        ));
        let refusal = refused(takeover, |t| t.active = 2);
        let (field, code) = ("active", 2);
        assert_eq!(refusal, Refusal::UnknownCode { field, code });
        assert_eq!(takeover.action().is_some(), active == 1);
    }
}

#[test]
fn steps_progress_episodes_health_and_policy_status() {
    let step = Step::default();
    assert!(matches!(
        refused(step, |s| s.observation.beam_count = 9999),
        Refusal::OverCapacity { .. }
    ));
    assert!(matches!(
        refused(step, |s| s.plan.waypoint_count = 9999),
        Refusal::OverCapacity { .. }
    ));
    assert!(matches!(
        refused(step, |s| s.takeover.steer = f64::NAN),
        Refusal::NotFinite { .. }
    ));
    assert!(matches!(
        refused(step, |s| s.policy.steer = f64::NAN),
        Refusal::NotFinite { .. }
    ));
    assert!(matches!(
        refused(step, |s| s.expert_assessment.verdict = 4),
        Refusal::UnknownCode { .. }
    ));
    assert!(matches!(
        refused(step, |s| s.policy_assessment.safe_s = -1.0),
        Refusal::OutOfRange { .. }
    ));

    assert!(matches!(
        refused(Progress::default(), |p| p.outcome = 5),
        Refusal::UnknownCode { .. }
    ));
    assert!(matches!(
        refused(Progress::default(), |p| p.completion = f64::NAN),
        Refusal::NotFinite { .. }
    ));
    assert!(matches!(
        refused(Health::default(), |h| h.state = 5),
        Refusal::UnknownCode { .. }
    ));
    assert_eq!(Learning::default().check(), Ok(()));
    assert!(matches!(
        refused(Health::default(), |h| h.scheduling_got = 3),
        Refusal::UnknownCode { .. }
    ));
    assert!(matches!(
        refused(Health::default(), |h| h.memory = 3),
        Refusal::UnknownCode { .. }
    ));
}

#[test]
fn age_and_future_are_judged_to_the_nanosecond() {
    let observation = observation();
    for (now, good) in [
        (NOW.0, true),
        (NOW.0 + LIMIT_NS, true),
        (NOW.0 + LIMIT_NS + 1, false),
        (NOW.0 - FUTURE_TOLERANCE_NS, true),
        (NOW.0 - FUTURE_TOLERANCE_NS - 1, false),
        (0, false),
        (u64::MAX, false),
    ] {
        assert_eq!(
            observation.admit(Instant(now), LIMIT_NS).is_ok(),
            good,
            "{now}"
        );
    }
}

fn frame_request() -> FrameRequest {
    FrameRequest {
        view: View::Ego.code(),
        width: 960,
        height: 720,
        ..FrameRequest::default()
    }
}

#[test]
fn requests_for_frames() {
    assert_eq!(frame_request().check(), Ok(()));
    assert_eq!(frame_request().actions(), None, "no proposals, no actions");
    for (width, height) in [(0, 480), (480, 0), (63, 480), (480, 2049), (u32::MAX, 1)] {
        let refusal = refused(frame_request(), |r| (r.width, r.height) = (width, height));
        assert!(
            matches!(refusal, Refusal::OutOfRange { .. }),
            "{width} x {height}"
        );
    }
    let refusal = refused(frame_request(), |r| r.height = 721);
    assert!(
        matches!(refusal, Refusal::OverCapacity { .. }),
        "one row too many: {refusal}"
    );
    assert_eq!(
        refused(frame_request(), |r| r.view = 2),
        Refusal::UnknownCode {
            field: "view",
            code: 2
        }
    );
    assert_eq!(
        refused(frame_request(), |r| r.proposals[1].steer = f64::NAN),
        Refusal::NotFinite {
            field: "proposals[1]"
        }
    );
    assert!(matches!(
        refused(frame_request(), |r| r.proposals[0].pedal = -1.5),
        Refusal::OutOfRange { .. }
    ));
}

#[test]
fn foresight() {
    let outlook = Outlook {
        contact_s: 1.2,
        out_s: 3.0,
        completion: -0.01,
    };
    let good = Foresight {
        horizon_s: 3.0,
        outlooks: [outlook; 2],
        ..Foresight::default()
    };
    type Set = fn(&mut Foresight, f64);
    let fields: [(&str, Set); 4] = [
        ("horizon_s", |f, v| f.horizon_s = v),
        ("contact_s", |f, v| f.outlooks[0].contact_s = v),
        ("out_s", |f, v| f.outlooks[1].out_s = v),
        ("completion", |f, v| f.outlooks[1].completion = v),
    ];
    for (field, set) in fields {
        for value in [f64::NAN, f64::INFINITY] {
            let refusal = refused(good, |f| set(f, value));
            assert_eq!(refusal, Refusal::NotFinite { field }, "{value}");
        }
        for value in [-1.1, 60.1] {
            let refusal = refused(good, |f| set(f, value));
            assert!(
                matches!(refusal, Refusal::OutOfRange { field: f, .. } if f == field),
                "{field} = {value}: {refusal}"
            );
        }
    }
    let refusal = refused(good, |f| f.outlooks[0].out_s = 3.1);
    assert!(
        matches!(refusal, Refusal::OutOfRange { .. }),
        "later than the horizon"
    );
}

#[test]
fn cameras_of_frames() {
    let refusal = |spoil: fn(&mut Camera)| {
        let mut camera = Camera::top_down([480, 480]);
        assert_eq!(camera.check(), Ok(()));
        spoil(&mut camera);
        camera.check().err()
    };
    assert_eq!(
        refusal(|camera| camera.pixel_from_body[11] = f64::NAN),
        Some(Refusal::NotFinite {
            field: "camera.pixel_from_body"
        })
    );
    assert_eq!(
        refusal(|camera| camera.orthographic = 2),
        Some(Refusal::UnknownCode {
            field: "camera.orthographic",
            code: 2
        })
    );
    assert!(refusal(|camera| camera.near_m = -1.0).is_some());
    assert!(refusal(|camera| camera.position_body_m[2] = f64::INFINITY).is_some());
    assert!(refusal(|camera| camera.view = 9).is_some());
}

#[test]
fn orders_to_fail() {
    let good = Fault::default();
    assert_eq!(good.check(), Ok(()));
    let refusal = Fault { kind: 5, ..good }.check();
    assert!(matches!(refusal, Err(Refusal::UnknownCode { .. })));
    let refusal = Fault { target: 7, ..good }.check();
    assert!(matches!(refusal, Err(Refusal::UnknownCode { .. })));
}

/// Each check copies a frame of two megabytes.
const STACK_BYTES: usize = 64 << 20;

#[test]
fn frames() {
    let look = || {
        let good = Frame {
            header: Header::default(),
            camera: Camera::top_down([960, 720]),
            width: 960,
            height: 720,
            format: PixelFormat::Rgb8.code(),
            reserved: 0,
            pixels: [0; FRAME_BYTES_MAX],
            end: 0,
        };
        assert_eq!(good.check(), Ok(()));
        assert_eq!(good.rgb().len(), FRAME_BYTES_MAX);
        let spoilt = |spoil: fn(&mut Frame)| {
            let mut bad = good;
            spoil(&mut bad);
            assert!(bad.rgb().len() <= FRAME_BYTES_MAX);
            bad.check().err()
        };
        let over = |refusal| matches!(refusal, Some(Refusal::OverCapacity { .. }));
        assert!(over(spoilt(|f| f.height = 721)));
        assert!(over(spoilt(|f| (f.width, f.height) = (u32::MAX, u32::MAX))));
        assert!(spoilt(|f| f.format = 1).is_some());
        assert!(spoilt(|f| f.camera.near_m = f64::NAN).is_some());
    };
    let thread = std::thread::Builder::new().stack_size(STACK_BYTES);
    let thread = thread.spawn(look).expect("a thread");
    thread.join().expect("all of it held");
}

proptest! {
    /// For any bytes of a publisher, the check returns, and an admitted message can be
    /// used without a panic.
    #[test]
    fn any_bytes_are_judged_without_a_panic(bits in prop::collection::vec(any::<u64>(), 19 + 4), beams in any::<u32>(), range in any::<u32>()) {
        let value = |k: usize| f64::from_bits(bits[k]);
        let mut o = observation();
        o.ego = Ego { x_world_m: value(0), y_world_m: value(1), heading_world_rad: value(2), speed_mps: value(3),
                      yaw_rate_radps: value(4), steer: value(5), pedal: value(6) };
        o.road = Road { left_m: value(7), right_m: value(8), heading_rad: value(9), offset_m: value(10), lane_width_m: value(17) };
        (o.field_of_view_rad, o.scanner_heading_rad) = (value(18), value(19));
        (o.scanner_x_body_m, o.scanner_y_body_m) = (value(20), value(21));
        o.checkpoints[0] = Checkpoint { x_body_m: value(11), y_body_m: value(12), bend_radius_m: value(13),
                                        bend_angle_rad: value(14), bend: bits[15] as u32, reserved: 0 };
        o.beam_count = beams;
        o.ranges_m[3] = f32::from_bits(range);
        o.header.taken_ns = bits[16];
        let admitted = o.admit(NOW, LIMIT_NS);
        let mut features = [0.0; 19 + BEAMS_MAX];
        let features = o.features(&mut features).expect("there is room");
        if admitted.is_ok() {
            prop_assert!(features.iter().all(|f| (0.0..=1.0).contains(f)));
        }
    }

    /// Codes of every closed list survive the round trip; all others are refused.
    #[test]
    fn codes_are_closed(code in any::<u32>()) {
        for known in Reason::ALL {
            prop_assert_eq!(Reason::from_code(known.code()), Some(*known));
        }
        prop_assert_eq!(Reason::from_code(code).is_some(), (code as usize) < Reason::ALL.len());
        prop_assert_eq!(Driver::from_code(code).is_some(), code < 3);
    }
}
