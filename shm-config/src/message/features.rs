//! The feature map: what the policy's input means. It is that of the paper's task, in
//! this file alone; a policy file names it by [`OBSERVATION_LAYOUT`].

use super::{Bend, Checkpoint, Observation};
use crate::layout::{FNV_BASIS, fnv1a};
#[cfg(not(feature = "std"))]
use vehicle::Float as _;
use vehicle::{Fan, Point};

/// Numbers before those of the beams.
pub const STATE_FEATURES: usize = 19;
/// Beams of the scanner that policies are trained with: the full circle, from the car's
/// centre, the first beam along its heading.
pub const FEATURE_BEAMS: usize = 240;
/// Length of the policy's input.
pub const FEATURES: usize = STATE_FEATURES + FEATURE_BEAMS;
/// The version of the meaning of [`Observation::features`]. Raise it whenever a feature
/// changes its meaning, scale or position: weights trained for another version are
/// refused. A test pins the features of one observation.
pub const FEATURES_VERSION: u32 = 1;
/// The feature map that weights are trained for: count and meaning of the policy's
/// input in one number.
pub const OBSERVATION_LAYOUT: u64 = fnv1a(
    fnv1a(FNV_BASIS, &(FEATURES as u64).to_le_bytes()),
    &FEATURES_VERSION.to_le_bytes(),
);

/// Sectors of the circle in each of which a policy may be told how the nearest return moves.
pub const MOTION_SECTORS: usize = 60;
/// Numbers of the policy's input that tell how bodies move: the velocity of the nearest return
/// in each sector, forward and to the left. A scan alone does not show it.
pub const MOTION_FEATURES: usize = 2 * MOTION_SECTORS;
/// Length of the input of a policy that is told how bodies move.
pub const INPUTS_WITH_MOTION: usize = FEATURES + MOTION_FEATURES;
/// The feature of a component of a velocity that is zero.
pub const MOTION_AT_REST: f32 = 0.5;
/// The version of the meaning of [`motion_feature`] and [`motion_sector`].
const MOTION_VERSION: u32 = 1;
/// The feature map of weights that are told how bodies move.
pub const MOTION_LAYOUT: u64 = fnv1a(OBSERVATION_LAYOUT, &MOTION_VERSION.to_le_bytes());

/// Velocity over ground that is shown as 1, m/s; minus that is shown as 0.
const MOTION_MPS: f64 = 20.0;
/// Beams of a sector. The first sector has its middle ahead.
const SECTOR_BEAMS: usize = FEATURE_BEAMS / MOTION_SECTORS;

/// Distance to an edge of the road that is shown as 1, m: four lanes of 4.5 m.
const EDGE_M: f64 = 18.0;
/// Widest lane, m.
const LANE_M: f64 = 4.5;
/// Speed that is shown as 1, km/h, and what is added to it.
const SPEED_KPH: f64 = 81.0;
const SPEED_OFFSET_KPH: f64 = 1.0;
/// The simulator divides the steering by its largest wheel angle once more, and so does
/// this code.
const STEER_DEG: f64 = 60.0;
/// Distance of a checkpoint that is shown as 1, m: the range of the task's lidar. A
/// farther one is drawn nearer, in the same direction.
const CHECKPOINT_M: f64 = 50.0;
/// Bend radius that is shown as 1, m: the largest of the task (60 m) and three lanes of
/// 3.5 m.
const BEND_RADIUS_M: f64 = 70.5;
/// Bend angle that is shown as 1, degrees.
const BEND_DEG: f64 = 135.0;

/// Whether policies are trained with such a scan: see [`Observation::fits_policy`].
pub fn fits_policy(fan: &Fan) -> bool {
    fan.beams == FEATURE_BEAMS
        && fan.is_circle()
        && fan.heading_rad == 0.0
        && fan.mount_body == Point::origin()
}

/// The feature in [0, 1] of a component of a velocity over ground, m/s.
pub fn motion_feature(velocity_mps: f64) -> f32 {
    (f64::from(MOTION_AT_REST) + velocity_mps / (2.0 * MOTION_MPS)).clamp(0.0, 1.0) as f32
}

/// The sector of a beam of a scan that policies are trained with. Sector 0 is ahead, the
/// others follow counter-clockwise.
pub fn motion_sector(beam: usize) -> usize {
    (beam + SECTOR_BEAMS / 2) / SECTOR_BEAMS % MOTION_SECTORS
}

impl Observation {
    /// Length of [`Observation::features`] for this many beams.
    pub fn feature_count(&self) -> usize {
        STATE_FEATURES + self.ranges().len()
    }

    /// Whether its scan is one that policies are trained with: [`FEATURE_BEAMS`] over
    /// the full circle, from the car's centre. The features of any other scan have
    /// another meaning, so no policy is asked.
    pub fn fits_policy(&self) -> bool {
        fits_policy(&self.fan())
    }

    /// The input of a policy: [`FEATURES`] numbers; `None` when no policy is trained
    /// with such a scan or `out` is shorter.
    pub fn policy_features<'a>(&self, out: &'a mut [f32]) -> Option<&'a [f32]> {
        match self.fits_policy() {
            true => self.features(out),
            false => None,
        }
    }

    /// The observation as numbers in [0, 1]: MetaDrive's 19 and one for each beam.
    /// Training and driving use this same function.
    ///
    /// Fills the first [`Observation::feature_count`] places and returns them;
    /// `None` when `out` is shorter.
    pub fn features<'a>(&self, out: &'a mut [f32]) -> Option<&'a [f32]> {
        let out = out.get_mut(..self.feature_count())?;
        let unit = |value: f64| value.clamp(0.0, 1.0) as f32;
        let Self { ego, road, .. } = self;
        out[0] = unit(road.left_m / EDGE_M);
        out[1] = unit(road.right_m / EDGE_M);
        out[2] = unit(0.5 - 0.5 * road.heading_rad.sin());
        out[3] = unit((ego.speed_mps * 3.6 + SPEED_OFFSET_KPH) / SPEED_KPH);
        out[4] = unit((ego.steer / STEER_DEG + 1.0) / 2.0);
        out[5] = unit((ego.steer + 1.0) / 2.0);
        out[6] = unit((ego.pedal + 1.0) / 2.0);
        out[7] = unit(ego.yaw_rate_radps.abs());
        out[8] = unit(0.5 - road.offset_m / LANE_M);
        let blocks = out[9..STATE_FEATURES].chunks_exact_mut(5);
        for (block, checkpoint) in blocks.zip(&self.checkpoints) {
            checkpoint.features(block);
        }
        for (feature, &range_m) in out[STATE_FEATURES..].iter_mut().zip(self.ranges()) {
            *feature = (range_m / self.lidar_max_m).clamp(0.0, 1.0);
        }
        Some(out)
    }
}

impl Checkpoint {
    /// The five numbers of a checkpoint block.
    fn features(&self, out: &mut [f32]) {
        let unit = |value: f64| value.clamp(0.0, 1.0) as f32;
        let distance_m = self.x_body_m.hypot(self.y_body_m);
        let scale = if distance_m > CHECKPOINT_M {
            CHECKPOINT_M / distance_m
        } else {
            1.0
        };
        out[0] = unit((self.x_body_m * scale / CHECKPOINT_M + 1.0) / 2.0);
        out[1] = unit((self.y_body_m * scale / CHECKPOINT_M + 1.0) / 2.0);
        out[2] = unit(self.bend_radius_m / BEND_RADIUS_M);
        out[3] = match self.bend() {
            Bend::Left => 0.0,
            Bend::Straight => 0.5,
            Bend::Right => 1.0,
        };
        out[4] = match self.bend() {
            Bend::Straight => 0.5,
            Bend::Left | Bend::Right => {
                unit((self.bend_angle_rad.to_degrees() / BEND_DEG + 1.0) / 2.0)
            }
        };
    }
}
