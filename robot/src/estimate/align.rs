use nalgebra::{Matrix3, Vector3};
use vehicle::{Pose, pose, wrap_rad};

use super::Outline;
use super::measurement::INFORMATION_MIN;

/// Most iterations; from a guess 0.3 m away it takes five.
const ITERATIONS: usize = 30;
/// Iterations in which a point may be as far from its line as the guess is wrong.
const WIDE: usize = 6;
/// Greatest distance of a point from its partner, m: at first, and then.
const WIDE_M: f64 = 1.0;
const NARROW_M: f64 = 0.4;
/// Partners are looked for among the beams this far beside a point, rad.
const BESIDE_RAD: f64 = 0.15;
/// Fewest points with a partner.
const PAIRS_MIN: usize = 20;
/// A step shorter than this, m and rad, is the last.
const STEP_MIN: f64 = 1e-4;
/// Noise may let some points change between two partners for ever: the last step is then
/// about this long at most, a tenth of a range's noise.
const CYCLE_MAX: f64 = 2e-3;
/// Error of a line besides, m: 0.5 m beside its place a wall of 25 m radius is 5 mm off it.
const LINE_STD_M: f64 = 0.005;
/// Standard deviations beyond which a point weighs less (Huber).
const FAR_STDS: f64 = 2.0;
/// A direction with a smaller share of the information of all points than this is not
/// observed. The noise of the normals alone gives one of `tilt_rad2`, so three times that
/// counts as nothing, too.
const SHARE_MIN: f64 = 0.01;
const TILTS_MIN: f64 = 3.0;

/// Two outlines that do not fit.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Unaligned {
    /// Too few points of one are beside a line of the other.
    #[error("{pairs} points of {} have a partner", PAIRS_MIN)]
    Pairs {
        /// How many are.
        pairs: usize,
    },
    /// The steps do not become short.
    #[error("the alignment does not converge in {} iterations", ITERATIONS)]
    Diverged,
}

/// Where a scan was taken in the frame of another one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aligned {
    /// The body at the scan in the body frame of the reference, m and rad.
    pub reference_from_body: Pose,
    /// Inverse covariance of (x, y, heading) in the frame of the reference, m and rad, from
    /// the noise of the ranges. A direction that the scans do not show has none.
    pub information: Matrix3<f64>,
    /// Directions that the scans show, 0 to 3. In the others the pose is the guess.
    pub observed: usize,
    /// The motion that the scans show least: (x m, y m, heading rad). Along a corridor it is
    /// (1, 0, 0) in the corridor's frame; in a ring it is a turn about its centre. It is
    /// scaled so that the longer of way and turn times `lever_m` is 1 m.
    pub weakest: Vector3<f64>,
    /// Root mean square distance of the points from the axis about which they turn, m.
    pub lever_m: f64,
    /// Points with a partner.
    pub pairs: usize,
}

impl Aligned {
    /// The same with an error that all points have in common, as a standard deviation, m
    /// (in heading, that of this distance at the lever), added to each direction that the
    /// scans show: an error of the map, a distorted scan, or the error of a direction itself.
    /// The last one matters where a direction is not observed: the others are then a little
    /// wrong, and with the noise of the ranges alone the guess would confirm itself.
    #[must_use]
    pub fn blurred(&self, std_m: f64) -> Self {
        let scale = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 1.0 / self.lever_m));
        let unscale = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, self.lever_m));
        let eigen = (scale * self.information * scale).symmetric_eigen();
        let least = eigen.eigenvalues.max() * INFORMATION_MIN;
        let mut information = Matrix3::zeros();
        for (column, eigenvalue) in eigen.eigenvalues.iter().enumerate() {
            if *eigenvalue > least {
                let row = unscale * eigen.eigenvectors.column(column);
                information += row * row.transpose() / (1.0 / eigenvalue + std_m * std_m);
            }
        }
        Self {
            information: symmetric(&information),
            ..*self
        }
    }

    /// The pose of the body, and its information, in the frame in which the reference is at
    /// a pose: of a map, when the reference is a scan of the map from there.
    pub fn seen_from(&self, frame_from_reference: &Pose) -> (Pose, Matrix3<f64>) {
        let turn = frame_from_reference.rotation.to_rotation_matrix();
        let mut turned = Matrix3::identity();
        turned.fixed_view_mut::<2, 2>(0, 0).copy_from(turn.matrix());
        (
            frame_from_reference * self.reference_from_body,
            symmetric(&(turned * self.information * turned.transpose())),
        )
    }
}

/// The normal equations of a pose.
struct Sums {
    information: Matrix3<f64>,
    gradient: Vector3<f64>,
    pairs: usize,
    /// Weighted mean of the variances of the lines' directions, rad².
    tilt_rad2: f64,
}

/// The directions that the normal equations observe.
struct Observed {
    /// Their part of the information.
    information: Matrix3<f64>,
    /// The step in them.
    step: Vector3<f64>,
    count: usize,
    weakest: Vector3<f64>,
    lever_m: f64,
}

/// Finds where a scan was taken in the frame of a reference, from a guess: the iterated
/// closest points with the distances from lines (Censi, *An ICP variant using a
/// point-to-line metric*, ICRA 2008), in the directions that the scans show (Zhang, Kaess
/// and Singh, *On Degeneracy of Optimization-based State Estimation Problems*, ICRA 2016).
/// The information is that of the normal equations with the noise of both scans along
/// their beams; the part that Censi adds for the derivative of the partners (*An accurate
/// closed-form estimate of ICP's covariance*, ICRA 2007) is left out.
///
/// The guess should be within 0.5 m and 5 degrees. Nothing allocates.
///
/// # Errors
/// Fewer than 20 points have a partner, or the iteration does not converge.
pub fn align(reference: &Outline, current: &Outline, guess: &Pose) -> Result<Aligned, Unaligned> {
    let mut at = Vector3::new(
        guess.translation.x,
        guess.translation.y,
        guess.rotation.angle(),
    );
    for iteration in 0..ITERATIONS {
        let away_m = if iteration < WIDE { WIDE_M } else { NARROW_M };
        let sums = sums(reference, current, &at, away_m);
        if sums.pairs < PAIRS_MIN {
            return Err(Unaligned::Pairs { pairs: sums.pairs });
        }
        let observed = sums.observed();
        at += observed.step;
        at.z = wrap_rad(at.z);
        let enough = match iteration + 1 == ITERATIONS {
            true => CYCLE_MAX,
            false => STEP_MIN,
        };
        // The last steps are those of the narrow search.
        if observed.step.amax() < enough && iteration >= WIDE {
            return Ok(Aligned {
                reference_from_body: pose(at.x, at.y, at.z),
                information: observed.information,
                observed: observed.count,
                weakest: observed.weakest,
                lever_m: observed.lever_m,
                pairs: sums.pairs,
            });
        }
    }
    Err(Unaligned::Diverged)
}

/// The normal equations at a pose (x, y, heading).
fn sums(reference: &Outline, current: &Outline, at: &Vector3<f64>, away_m: f64) -> Sums {
    let reference_from_body = pose(at.x, at.y, at.z);
    let mount = reference_from_body * current.fan.mount_body;
    let [reference_m2, current_m2] =
        [reference, current].map(|outline| outline.range_std_m.powi(2));
    let mut sums = Sums {
        information: Matrix3::zeros(),
        gradient: Vector3::zeros(),
        pairs: 0,
        tilt_rad2: 0.0,
    };
    let mut weights = 0.0;
    for mark in current.marks.iter().flatten() {
        let place = reference_from_body * mark.place;
        let Some(line) = reference.nearest(place, away_m, BESIDE_RAD) else {
            continue;
        };
        let from_line = place - line.place;
        let along_m = line.normal.perp(&from_line).abs();
        if along_m > 2.0 * line.reach_m {
            continue;
        }
        let off_m = line.normal.dot(&from_line);
        // The noise is along the beam.
        let beam = (place - mount).normalize();
        let facing = line.normal.dot(&beam);
        let facing2 = facing * facing;
        // What the neighbours are off the line by is this noise, or a curve.
        let line_m2 = line.off_m2.max(reference_m2 * facing2) + LINE_STD_M * LINE_STD_M;
        let std_m = (line_m2 + current_m2 * facing2).sqrt();
        let far = (off_m / std_m).abs();
        let huber = if far > FAR_STDS { FAR_STDS / far } else { 1.0 };
        let weight = huber / (std_m * std_m);
        let arm = place.coords - reference_from_body.translation.vector;
        let by_pose = Vector3::new(line.normal.x, line.normal.y, arm.perp(&line.normal));
        sums.information += weight * by_pose * by_pose.transpose();
        sums.gradient -= weight * off_m * by_pose;
        sums.tilt_rad2 += weight * line.tilt_rad2;
        weights += weight;
        sums.pairs += 1;
    }
    sums.tilt_rad2 /= weights;
    sums
}

impl Sums {
    /// The directions with enough information. Metres and radians are compared at the lever
    /// at which the points see them alike.
    fn observed(&self) -> Observed {
        let total = self.information[(0, 0)] + self.information[(1, 1)];
        let lever_m = (self.information[(2, 2)] / total).sqrt().max(1e-3);
        // From metres at the lever to (m, m, rad).
        let scale = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 1.0 / lever_m));
        let eigen = (scale * self.information * scale / total).symmetric_eigen();
        let least = SHARE_MIN.max(TILTS_MIN * self.tilt_rad2);
        let weakest = eigen.eigenvectors.column(eigen.eigenvalues.imin());
        let mut observed = Observed {
            information: Matrix3::zeros(),
            step: Vector3::zeros(),
            count: 0,
            weakest: scale * weakest,
            lever_m,
        };
        let unscale = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, lever_m));
        let gradient = scale * self.gradient;
        for (column, share) in eigen.eigenvalues.iter().enumerate() {
            if *share < least {
                continue;
            }
            let direction = eigen.eigenvectors.column(column);
            let row = unscale * direction;
            observed.information += row * row.transpose() * (share * total);
            observed.step += scale * direction * (direction.dot(&gradient) / (share * total));
            observed.count += 1;
        }
        observed.information = symmetric(&observed.information);
        observed
    }
}

/// Equal on both sides of the diagonal, to the last bit.
fn symmetric(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    (matrix + matrix.transpose()) / 2.0
}
