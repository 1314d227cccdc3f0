use super::{Refusal, known, within};
#[cfg(not(feature = "std"))]
use vehicle::Float as _;

crate::word_list! {
    /// The view of a frame.
    pub enum View {
        /// Ahead, from over the driver's seat; the car itself is not in the way.
        Ego = 0 "ego",
        /// From above, heading up.
        TopDown = 1 "top_down",
    }
}

/// Width of the area in a top-down picture, m: slightly more than the lidar's range to
/// both sides.
pub const TOP_DOWN_ACROSS_M: f64 = 60.0;
/// Share of a top-down picture's height that lies ahead of the car.
pub const TOP_DOWN_AHEAD: f64 = 0.75;
/// Height of a top-down camera, m. The view does not depend on it; it is above
/// everything.
pub const TOP_DOWN_HEIGHT_M: f64 = 50.0;

/// Position of the camera above the driver's seat, m: behind the seat and above the
/// roof, so that the ground is visible from just before the car's middle, where the
/// paths of a question begin.
const EGO_POSITION_BODY_M: [f64; 3] = [-2.0, 0.0, 2.4];
/// Downward angle of the camera, rad: the horizon then lies at a third of the height.
const EGO_PITCH_RAD: f64 = 12.0 * core::f64::consts::PI / 180.0;
/// Angle between the left and right edges of the picture, rad.
const EGO_FIELD_RAD: f64 = 66.0 * core::f64::consts::PI / 180.0;
/// Nearer points are not visible, m.
const EGO_NEAR_M: f64 = 0.5;

crate::message! {
    /// A pinhole or orthographic camera: it projects points of the body frame to
    /// pixels.
    ///
    /// Pixels are counted from the left upper corner of the picture; the middle
    /// of the first one is at (0.5, 0.5).
    #[derive(Default)]
    pub struct Camera: 136 bytes {
        /// Row-major 3 x 4 matrix from homogeneous body coordinates (m; x forward,
        /// y left, z up from the ground) to homogeneous pixels (u right, v down).
        /// Its last row gives the distance along the optical axis, m; for
        /// orthographic views 1.
        pub pixel_from_body: [f64; 12],
        /// Position of the camera in the body frame, m.
        pub position_body_m: [f64; 3],
        /// Points nearer than this are not seen, m; for orthographic views 0.
        pub near_m: f64,
        /// A [`View`].
        pub view: u32,
        /// 1 for an orthographic projection, 0 for a pinhole.
        pub orthographic: u32,
    }
}

impl Camera {
    /// The camera that looks down on the car from above; width and height of the
    /// picture in pixels.
    pub fn top_down([width, height]: [u32; 2]) -> Self {
        let px_per_m = f64::from(width) / TOP_DOWN_ACROSS_M;
        let centre_u = f64::from(width) / 2.0;
        let centre_v = f64::from(height) * TOP_DOWN_AHEAD;
        let mut pixel_from_body = [0.0; 12];
        pixel_from_body[..4].copy_from_slice(&[0.0, -px_per_m, 0.0, centre_u]);
        pixel_from_body[4..8].copy_from_slice(&[-px_per_m, 0.0, 0.0, centre_v]);
        pixel_from_body[11] = 1.0;
        Self {
            pixel_from_body,
            position_body_m: [0.0, 0.0, TOP_DOWN_HEIGHT_M],
            near_m: 0.0,
            view: View::TopDown.code(),
            orthographic: 1,
        }
    }

    /// The camera over the driver's seat, which looks ahead; width and height of the
    /// picture in pixels.
    pub fn ego([width, height]: [u32; 2]) -> Self {
        let centre = [width, height].map(|side| f64::from(side) / 2.0);
        let focal_px = centre[0] / (EGO_FIELD_RAD / 2.0).tan();
        let (sin, cos) = EGO_PITCH_RAD.sin_cos();
        let (right, down, ahead) = ([0.0, -1.0, 0.0], [-sin, 0.0, -cos], [cos, 0.0, -sin]);
        let mixed = |axis: [f64; 3], centre_px: f64| {
            [0, 1, 2].map(|k| focal_px * axis[k] + centre_px * ahead[k])
        };
        let rows = [mixed(right, centre[0]), mixed(down, centre[1]), ahead];
        let mut pixel_from_body = [0.0; 12];
        for (row, out) in rows.iter().zip(pixel_from_body.chunks_exact_mut(4)) {
            out[..3].copy_from_slice(row);
            out[3] = -(0..3).map(|k| row[k] * EGO_POSITION_BODY_M[k]).sum::<f64>();
        }
        Self {
            pixel_from_body,
            position_body_m: EGO_POSITION_BODY_M,
            near_m: EGO_NEAR_M,
            view: View::Ego.code(),
            orthographic: 0,
        }
    }

    /// The camera of a view; width and height of the picture in pixels.
    pub fn of(view: View, size_px: [u32; 2]) -> Self {
        match view {
            View::Ego => Self::ego(size_px),
            View::TopDown => Self::top_down(size_px),
        }
    }

    /// How far along the optical axis a point of the body frame lies, m; 1 for
    /// orthographic views.
    pub fn depth(&self, point_body: [f64; 3]) -> f64 {
        self.row(2, point_body)
    }

    /// Whether a point is far enough ahead of the camera to be seen.
    pub fn is_ahead(&self, point_body: [f64; 3]) -> bool {
        let depth = self.depth(point_body);
        depth >= self.near_m && depth > 0.0
    }

    /// The pixel (u right, v down) of a point of the body frame, m; it may lie
    /// beside the picture. `None` for what is nearer than `near_m` or behind.
    pub fn project(&self, point_body: [f64; 3]) -> Option<[f64; 2]> {
        if !self.is_ahead(point_body) {
            return None;
        }
        let depth = self.depth(point_body);
        let pixel = [0, 1].map(|row| self.row(row, point_body) / depth);
        pixel.iter().all(|value| value.is_finite()).then_some(pixel)
    }

    fn row(&self, row: usize, point_body: [f64; 3]) -> f64 {
        let row = &self.pixel_from_body[row * 4..row * 4 + 4];
        let [x_m, y_m, z_m] = point_body;
        row[0] * x_m + row[1] * y_m + row[2] * z_m + row[3]
    }

    /// Checks that all numbers of a camera are in range.
    ///
    /// # Errors
    /// The first field that is not finite, out of range or of unknown code.
    pub fn check(&self) -> Result<(), Refusal> {
        for value in self.pixel_from_body {
            within("camera.pixel_from_body", value, -1e9..=1e9)?;
        }
        for value in self.position_body_m {
            within("camera.position_body_m", value, -1e4..=1e4)?;
        }
        within("camera.near_m", self.near_m, 0.0..=1e3)?;
        known("camera.view", self.view, View::from_code)?;
        known("camera.orthographic", self.orthographic, |code| {
            (code <= 1).then_some(code)
        })
    }
}

/// Outlines, which grow as they are cut.
#[cfg(feature = "std")]
impl Camera {
    /// The projection of a line through points of the body frame, pixels. Parts nearer
    /// than `near_m` are cut off, so one line may become several.
    pub fn project_line(&self, points_body: &[[f64; 3]]) -> Vec<Vec<[f64; 2]>> {
        let mut parts: Vec<Vec<[f64; 2]>> = Vec::new();
        let mut is_open = false;
        for pair in points_body.windows(2) {
            let [from_body, to_body] = [pair[0], pair[1]];
            let seen = self.clip(from_body, to_body);
            let pixels = seen.and_then(|[a, b]| Some([self.project(a)?, self.project(b)?]));
            let Some([from, to]) = pixels else {
                is_open = false;
                continue;
            };
            if !is_open {
                parts.push(vec![from]);
            }
            if let Some(part) = parts.last_mut() {
                part.push(to);
            }
            is_open = self.is_ahead(to_body);
        }
        parts
    }

    /// The projection of a polygon of the body frame, pixels, without the part nearer
    /// than `near_m`; empty when nothing is left. `out` is cleared.
    pub fn project_area(&self, corners_body: &[[f64; 3]], out: &mut Vec<[f64; 2]>) {
        out.clear();
        for (index, &corner) in corners_body.iter().enumerate() {
            let next = corners_body[(index + 1) % corners_body.len()];
            let Some([from, to]) = self.clip(corner, next) else {
                continue;
            };
            out.extend(self.project(from));
            // The next side begins where this one ends, unless it is cut off there.
            if !self.is_ahead(next) {
                out.extend(self.project(to));
            }
        }
    }

    /// The part of a line between two points that is far enough ahead.
    fn clip(&self, from_body: [f64; 3], to_body: [f64; 3]) -> Option<[[f64; 3]; 2]> {
        let at = |share: f64| {
            [0, 1, 2].map(|axis| from_body[axis] + (to_body[axis] - from_body[axis]) * share)
        };
        // The cut lies slightly beyond the limit, so that rounding does not lose it.
        let limit = self.near_m.max(f64::MIN_POSITIVE) * (1.0 + 1e-9);
        let [from, to] = [from_body, to_body].map(|point| self.depth(point));
        let cut = || at((limit - from) / (to - from));
        match [from_body, to_body].map(|point| self.is_ahead(point)) {
            [true, true] => Some([from_body, to_body]),
            [true, false] => Some([from_body, cut()]),
            [false, true] => Some([cut(), to_body]),
            [false, false] => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_matrix_is_that_of_the_angles() {
        let camera = Camera::ego([960, 720]);
        assert_eq!(camera.check(), Ok(()));
        // On the optical axis: the middle of the picture.
        let (sin, cos) = EGO_PITCH_RAD.sin_cos();
        let [x_m, y_m, z_m] = EGO_POSITION_BODY_M;
        let axis = [x_m + 10.0 * cos, y_m, z_m - 10.0 * sin];
        let [u, v] = camera.project(axis).expect("ahead");
        assert!(
            (u - 480.0).abs() < 1e-9 && (v - 360.0).abs() < 1e-9,
            "{u}, {v}"
        );
        assert!((camera.depth(axis) - 10.0).abs() < 1e-9);
        // Half the field to the left: the left rim.
        let left_m = 10.0 * (EGO_FIELD_RAD / 2.0).tan();
        let [u, v] = camera.project([axis[0], left_m, axis[2]]).expect("ahead");
        assert!(u.abs() < 1e-9 && (v - 360.0).abs() < 1e-9, "{u}, {v}");
        // Ten metres above the axis, across it: as far up as that is left.
        let above = [axis[0] + left_m * sin, 0.0, axis[2] + left_m * cos];
        let [u, v] = camera.project(above).expect("ahead");
        assert!(
            (u - 480.0).abs() < 1e-9 && (v - (360.0 - 480.0)).abs() < 1e-9,
            "{u}, {v}"
        );
        assert_eq!(camera.project(EGO_POSITION_BODY_M), None);
    }
}
