//! The camera over the driver's seat.

use shm_config::message::{Camera, View};

/// Where it is, m: behind the seat and over the roof, so that the ground is seen
/// from just before the car's middle on, where the paths of a question begin.
const POSITION_BODY_M: [f64; 3] = [-2.0, 0.0, 2.4];
/// How far it looks down, rad: the horizon then lies at a third of the height.
const PITCH_RAD: f64 = 12.0 * std::f64::consts::PI / 180.0;
/// Angle from the left rim of the picture to the right one, rad.
const FIELD_RAD: f64 = 66.0 * std::f64::consts::PI / 180.0;
/// What is nearer is not seen, m.
const NEAR_M: f64 = 0.5;

/// The camera for a picture of that width and height, pixels.
pub fn camera([width, height]: [u32; 2]) -> Camera {
    let centre = [width, height].map(|side| f64::from(side) / 2.0);
    let focal_px = centre[0] / (FIELD_RAD / 2.0).tan();
    let (sin, cos) = PITCH_RAD.sin_cos();
    let (right, down, ahead) = ([0.0, -1.0, 0.0], [-sin, 0.0, -cos], [cos, 0.0, -sin]);
    let mixed = |axis: [f64; 3], centre_px: f64| {
        [0, 1, 2].map(|k| focal_px * axis[k] + centre_px * ahead[k])
    };
    let rows = [mixed(right, centre[0]), mixed(down, centre[1]), ahead];
    let mut pixel_from_body = [0.0; 12];
    for (row, out) in rows.iter().zip(pixel_from_body.chunks_exact_mut(4)) {
        out[..3].copy_from_slice(row);
        out[3] = -(0..3).map(|k| row[k] * POSITION_BODY_M[k]).sum::<f64>();
    }
    Camera {
        pixel_from_body,
        position_body_m: POSITION_BODY_M,
        near_m: NEAR_M,
        view: View::Ego.code(),
        orthographic: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_matrix_is_that_of_the_angles() {
        let camera = camera([960, 720]);
        assert_eq!(camera.check(), Ok(()));
        // On the optical axis: the middle of the picture.
        let (sin, cos) = PITCH_RAD.sin_cos();
        let [x_m, y_m, z_m] = POSITION_BODY_M;
        let axis = [x_m + 10.0 * cos, y_m, z_m - 10.0 * sin];
        let [u, v] = camera.project(axis).expect("ahead");
        assert!(
            (u - 480.0).abs() < 1e-9 && (v - 360.0).abs() < 1e-9,
            "{u}, {v}"
        );
        assert!((camera.depth(axis) - 10.0).abs() < 1e-9);
        // Half the field to the left: the left rim.
        let left_m = 10.0 * (FIELD_RAD / 2.0).tan();
        let [u, v] = camera.project([axis[0], left_m, axis[2]]).expect("ahead");
        assert!(u.abs() < 1e-9 && (v - 360.0).abs() < 1e-9, "{u}, {v}");
        // Ten metres above the axis, across it: as far up as that is left.
        let above = [axis[0] + left_m * sin, 0.0, axis[2] + left_m * cos];
        let [u, v] = camera.project(above).expect("ahead");
        assert!(
            (u - 480.0).abs() < 1e-9 && (v - (360.0 - 480.0)).abs() < 1e-9,
            "{u}, {v}"
        );
        assert_eq!(camera.project(POSITION_BODY_M), None);
    }
}
