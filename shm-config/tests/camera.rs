//! Tests of the projection of points of the body frame.

use shm_config::message::{Camera, View};

/// A pinhole camera 2 m above the body's origin, looking ahead, with 400 pixels per
/// radian in the middle of a picture of 400 x 300.
fn pinhole() -> Camera {
    let mut camera = Camera {
        position_body_m: [0.0, 0.0, 2.0],
        near_m: 0.5,
        view: View::Ego.code(),
        ..Camera::default()
    };
    camera.pixel_from_body = [
        200.0, -400.0, 0.0, 0.0, //
        150.0, 0.0, -400.0, 800.0, //
        1.0, 0.0, 0.0, 0.0,
    ];
    camera
}

fn assert_near(found: Option<[f64; 2]>, wanted: [f64; 2]) {
    let found = found.expect("it is seen");
    let apart = (found[0] - wanted[0]).hypot(found[1] - wanted[1]);
    assert!(apart < 1e-6, "{found:?} in place of {wanted:?}");
}

#[test]
fn from_above_the_car_stands_at_three_quarters_and_heads_up() {
    let camera = Camera::top_down([480, 320]);
    assert_near(camera.project([0.0, 0.0, 0.0]), [240.0, 240.0]);
    assert_near(camera.project([10.0, 0.0, 0.0]), [240.0, 160.0]);
    assert_near(camera.project([0.0, 30.0, 0.0]), [0.0, 240.0]);
    assert_near(camera.project([-10.0, -30.0, 7.0]), [480.0, 320.0]);
}

#[test]
fn a_pinhole_sees_left_on_the_left_and_the_ground_below() {
    let camera = pinhole();
    assert_near(camera.project([10.0, 0.0, 2.0]), [200.0, 150.0]);
    assert_near(camera.project([10.0, 1.0, 2.0]), [160.0, 150.0]);
    assert_near(camera.project([10.0, 0.0, 0.0]), [200.0, 230.0]);
    assert_eq!(camera.depth([7.0, 3.0, -1.0]), 7.0);
}

#[test]
fn what_is_nearer_than_the_limit_is_not_seen() {
    let camera = pinhole();
    for x_m in [0.499, 0.0, -5.0, f64::NAN] {
        assert_eq!(camera.project([x_m, 0.0, 0.0]), None, "{x_m}");
    }
    assert!(camera.project([0.5, 0.0, 0.0]).is_some());
    assert_eq!(
        Camera::default().project([1.0, 1.0, 1.0]),
        None,
        "no camera"
    );
}

#[test]
fn lines_are_cut_where_they_come_too_near() {
    let camera = pinhole();
    // Ahead, behind the camera, and ahead again: two parts.
    let line = [
        [4.0, 0.0, 0.0],
        [2.0, 0.0, 0.0],
        [-2.0, 1.0, 0.0],
        [4.0, 2.0, 0.0],
    ];
    let parts = camera.project_line(&line);
    assert_eq!(
        parts.iter().map(Vec::len).collect::<Vec<_>>(),
        [3, 2],
        "{parts:?}"
    );
    // It leaves at x = 0.5: 3/8 of the way from (2, 0) to (-2, 1).
    let left_m = 0.375;
    let cut = [200.0 - 400.0 * left_m / 0.5, 150.0 + 400.0 * 2.0 / 0.5];
    assert!((parts[0][2][0] - cut[0]).abs() < 1e-3 && (parts[0][2][1] - cut[1]).abs() < 1e-3);
    assert_eq!(
        camera.project_line(&[[1.0, 0.0, 0.0]]),
        Vec::<Vec<[f64; 2]>>::new()
    );
    let whole = camera.project_line(&line[..2]);
    assert_eq!(whole.len(), 1);
    assert_near(Some(whole[0][1]), camera.project(line[1]).expect("seen"));
}

#[test]
fn areas_keep_only_what_is_ahead() {
    let camera = pinhole();
    let mut seen = vec![[1.0, 1.0]];
    // A lane that runs under the camera: its two far corners, and two cuts.
    let lane = [
        [-9.0, -2.0, 0.0],
        [20.0, -2.0, 0.0],
        [20.0, 2.0, 0.0],
        [-9.0, 2.0, 0.0],
    ];
    camera.project_area(&lane, &mut seen);
    assert_eq!(seen.len(), 4, "{seen:?}");
    let lowest = 150.0 + 400.0 * 2.0 / 0.5;
    let far = 150.0 + 400.0 * 2.0 / 20.0;
    for (v, wanted) in seen
        .iter()
        .map(|pixel| pixel[1])
        .zip([lowest, far, far, lowest])
    {
        assert!((v - wanted).abs() < 1e-3, "{seen:?}");
    }
    camera.project_area(&lane.map(|[x, y, z]| [x - 30.0, y, z]), &mut seen);
    assert!(seen.is_empty(), "all of it is behind");
    camera.project_area(&[], &mut seen);
    assert!(seen.is_empty());
}
