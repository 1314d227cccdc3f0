use super::{Header, Message, Refusal, fits, header_accessors, known, within};
use crate::Instant;
use crate::layout::{FNV_BASIS, fnv1a};
#[cfg(not(feature = "std"))]
use vehicle::Float as _;

/// Most lidar beams a world may have.
pub const BEAMS_MAX: usize = 512;
/// Navigation checkpoints ahead that an observation carries.
pub const CHECKPOINTS: usize = 2;
/// Length of the policy's input for 240 beams.
pub const FEATURES: usize = 259;
/// The version of the meaning of [`Observation::features`]. Raise it whenever a feature
/// changes its meaning, scale or position: weights trained for another version are
/// refused. A test pins the features of one observation.
pub const FEATURES_VERSION: u32 = 1;
/// The observation layout that weights are trained for: count and meaning of
/// the policy's input in one number.
pub const OBSERVATION_LAYOUT: u64 = fnv1a(
    fnv1a(FNV_BASIS, &(FEATURES as u64).to_le_bytes()),
    &FEATURES_VERSION.to_le_bytes(),
);

/// Largest distance of a position from the run's origin, m.
const POSITION_LIMIT_M: f64 = 1e6;
/// Largest speed of a car, m/s.
pub(super) const SPEED_LIMIT_MPS: f64 = 150.0;
/// Largest width of a road, m.
const LATERAL_LIMIT_M: f64 = 1e3;

crate::message! {
    /// The car itself.
    #[derive(Default)]
    pub struct Ego: 56 bytes {
        /// Position in the world (odometry) frame, m.
        pub x_world_m: f64,
        /// Position in the world (odometry) frame, m.
        pub y_world_m: f64,
        /// Heading in the world frame, rad, counter-clockwise.
        pub heading_world_rad: f64,
        /// Speed along the heading, m/s.
        pub speed_mps: f64,
        /// Turning rate, rad/s, counter-clockwise; over the last period.
        pub yaw_rate_radps: f64,
        /// The steering last applied, normalised.
        pub steer: f64,
        /// The pedal last applied, normalised.
        pub pedal: f64,
    }
}

crate::message! {
    /// The road where the car is.
    #[derive(Default)]
    pub struct Road: 32 bytes {
        /// Distance from the car's centre to the road's left edge, m; negative beyond it.
        pub left_m: f64,
        /// Distance from the car's centre to the road's right edge, m; negative beyond it.
        pub right_m: f64,
        /// Heading of the car in the road frame, rad: positive points left of the lane.
        pub heading_rad: f64,
        /// Offset from the centre of the car's lane, m, positive **left**.
        pub offset_m: f64,
    }
}

crate::word_list! {
    /// The direction in which the road to a checkpoint bends.
    pub enum Bend {
        /// It is straight.
        Straight = 0 "straight",
        /// Counter-clockwise.
        Left = 1 "left",
        /// Clockwise.
        Right = 2 "right",
    }
}

crate::message! {
    /// A navigation checkpoint: the end of a road of the route, at its middle.
    #[derive(Default)]
    pub struct Checkpoint: 40 bytes {
        /// Position, m, forward of the car.
        pub x_body_m: f64,
        /// Position, m, left of the car.
        pub y_body_m: f64,
        /// Radius of the bend of the road's leftmost lane, m; 0 when straight.
        pub bend_radius_m: f64,
        /// Angle of the bend, rad, never negative; 0 when straight.
        pub bend_angle_rad: f64,
        /// A [`Bend`].
        pub bend: u32,
        /// Not used.
        pub reserved: u32,
    }
}

crate::message! {
    /// The car's observation at one tick, in physical quantities.
    pub struct Observation: 2280 bytes, nested [Header, Ego, Road, Checkpoint] {
        /// Which tick, and when.
        pub header: Header,
        /// The instant of the run's grid at which this tick was due, ns on the
        /// machine's clock. A world with a higher rate than the run publishes several
        /// observations of a tick; this instant and the tick are the same in all of
        /// them.
        pub scheduled_ns: u64,
        /// When the world's tick began, ns on the machine's clock.
        pub released_ns: u64,
        /// When the tick's first observation was published, which woke its readers,
        /// ns on the machine's clock. The same in all observations of a tick.
        pub published_ns: u64,
        /// The car.
        pub ego: Ego,
        /// Its road.
        pub road: Road,
        /// The next two checkpoints of the route; the last one repeats.
        pub checkpoints: [Checkpoint; 2],
        /// Range of a beam that hits nothing, m.
        pub lidar_max_m: f32,
        /// How many beams are valid; evenly spaced over the full circle.
        pub beam_count: u32,
        /// Range of beam k at `k * 360 deg / beam_count` counter-clockwise from
        /// the heading, m, at most `lidar_max_m`.
        pub ranges_m: [f32; 512],
    }
}

const _: () = assert!(
    BEAMS_MAX == 512 && CHECKPOINTS == 2,
    "as the message declares"
);
const _: () = assert!(FEATURES == 19 + 240);

impl Default for Observation {
    fn default() -> Self {
        Self {
            header: Header::default(),
            scheduled_ns: 0,
            released_ns: 0,
            published_ns: 0,
            ego: Ego::default(),
            road: Road::default(),
            checkpoints: [Checkpoint::default(); CHECKPOINTS],
            lidar_max_m: 50.0,
            beam_count: 0,
            ranges_m: [0.0; BEAMS_MAX],
        }
    }
}

impl Message for Observation {
    header_accessors!();

    fn check(&self) -> Result<(), Refusal> {
        let position = -POSITION_LIMIT_M..=POSITION_LIMIT_M;
        let speed = -SPEED_LIMIT_MPS..=SPEED_LIMIT_MPS;
        let lateral = -LATERAL_LIMIT_M..=LATERAL_LIMIT_M;
        let unit = -1.0..=1.0;
        within("ego.x_world_m", self.ego.x_world_m, position.clone())?;
        within("ego.y_world_m", self.ego.y_world_m, position.clone())?;
        within(
            "ego.heading_world_rad",
            self.ego.heading_world_rad,
            -1e3..=1e3,
        )?;
        within("ego.speed_mps", self.ego.speed_mps, speed)?;
        within(
            "ego.yaw_rate_radps",
            self.ego.yaw_rate_radps,
            -100.0..=100.0,
        )?;
        within("ego.steer", self.ego.steer, unit.clone())?;
        within("ego.pedal", self.ego.pedal, unit)?;
        within("road.left_m", self.road.left_m, lateral.clone())?;
        within("road.right_m", self.road.right_m, lateral.clone())?;
        within("road.heading_rad", self.road.heading_rad, -4.0..=4.0)?;
        within("road.offset_m", self.road.offset_m, lateral)?;
        for checkpoint in &self.checkpoints {
            within("checkpoint.x_body_m", checkpoint.x_body_m, position.clone())?;
            within("checkpoint.y_body_m", checkpoint.y_body_m, position.clone())?;
            within(
                "checkpoint.bend_radius_m",
                checkpoint.bend_radius_m,
                0.0..=1e5,
            )?;
            within(
                "checkpoint.bend_angle_rad",
                checkpoint.bend_angle_rad,
                0.0..=7.0,
            )?;
            known("checkpoint.bend", checkpoint.bend, Bend::from_code)?;
        }
        within("lidar_max_m", f64::from(self.lidar_max_m), 0.1..=1e3)?;
        fits("beam_count", u64::from(self.beam_count), BEAMS_MAX)?;
        // The bits of non-negative floats are ordered like their values; negative
        // values and NaN are above all. A single pass without an early exit keeps this
        // loop vectorised.
        let max_m = self.lidar_max_m;
        let bits_max = max_m.to_bits();
        let good = self
            .ranges()
            .iter()
            .fold(true, |good, range_m| good & (range_m.to_bits() <= bits_max));
        if good {
            return Ok(());
        }
        self.ranges()
            .iter()
            .try_for_each(|&range_m| within("ranges_m", f64::from(range_m), 0.0..=f64::from(max_m)))
    }
}

impl Observation {
    /// The valid ranges, m; at most the capacity, even if the count is larger.
    pub fn ranges(&self) -> &[f32] {
        &self.ranges_m[..(self.beam_count as usize).min(BEAMS_MAX)]
    }

    /// When the observation woke its readers, on the machine's clock; never before it
    /// was due, even if its producer claims so.
    pub fn published(&self) -> Instant {
        Instant(self.published_ns.max(self.scheduled_ns))
    }

    /// Length of [`Observation::features`] for this many beams.
    pub fn feature_count(&self) -> usize {
        19 + self.ranges().len()
    }

    /// The policy's input, each number in [0, 1]: MetaDrive's 19 numbers and one for
    /// each beam. Training and driving use this same function.
    ///
    /// Fills the first [`Observation::feature_count`] places and returns them;
    /// `None` when `out` is shorter.
    pub fn features<'a>(&self, out: &'a mut [f32]) -> Option<&'a [f32]> {
        let out = out.get_mut(..self.feature_count())?;
        let unit = |value: f64| value.clamp(0.0, 1.0) as f32;
        let Self { ego, road, .. } = self;
        // 18 m: room for four lanes of 4.5 m beside the car.
        out[0] = unit(road.left_m / 18.0);
        out[1] = unit(road.right_m / 18.0);
        out[2] = unit(0.5 - 0.5 * road.heading_rad.sin());
        out[3] = unit((ego.speed_mps * 3.6 + 1.0) / 81.0);
        // The simulator divides the action by 60 degrees once more, and so does this
        // code.
        out[4] = unit((ego.steer / 60.0 + 1.0) / 2.0);
        out[5] = unit((ego.steer + 1.0) / 2.0);
        out[6] = unit((ego.pedal + 1.0) / 2.0);
        out[7] = unit(ego.yaw_rate_radps.abs());
        out[8] = unit(0.5 - road.offset_m / 4.5);
        for (block, checkpoint) in out[9..19].chunks_exact_mut(5).zip(&self.checkpoints) {
            checkpoint.features(block);
        }
        for (feature, &range_m) in out[19..].iter_mut().zip(self.ranges()) {
            *feature = (range_m / self.lidar_max_m).clamp(0.0, 1.0);
        }
        Some(out)
    }
}

impl Checkpoint {
    /// The direction of the bend; an unknown code is read as straight.
    pub fn bend(&self) -> Bend {
        Bend::from_code(self.bend).unwrap_or(Bend::Straight)
    }

    /// The five numbers of a checkpoint block.
    fn features(&self, out: &mut [f32]) {
        let unit = |value: f64| value.clamp(0.0, 1.0) as f32;
        // The vector is shortened to the lidar's 50 m, keeping its direction.
        let distance_m = self.x_body_m.hypot(self.y_body_m);
        let scale = if distance_m > 50.0 {
            50.0 / distance_m
        } else {
            1.0
        };
        out[0] = unit((self.x_body_m * scale / 50.0 + 1.0) / 2.0);
        out[1] = unit((self.y_body_m * scale / 50.0 + 1.0) / 2.0);
        // 70.5 m: the largest bend radius (60 m) and three lanes of 3.5 m.
        out[2] = unit(self.bend_radius_m / 70.5);
        out[3] = match self.bend() {
            Bend::Left => 0.0,
            Bend::Straight => 0.5,
            Bend::Right => 1.0,
        };
        out[4] = match self.bend() {
            Bend::Straight => 0.5,
            Bend::Left | Bend::Right => {
                unit((self.bend_angle_rad.to_degrees() / 135.0 + 1.0) / 2.0)
            }
        };
    }
}
