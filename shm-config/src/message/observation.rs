use super::{Header, Message, Refusal, fits, header_accessors, known, within};
use core::f64::consts::{PI, TAU};

use crate::Instant;
use vehicle::{Fan, Point};

/// Most lidar beams a world may have.
pub use vehicle::BEAMS_MAX;
/// Navigation checkpoints ahead that an observation carries.
pub const CHECKPOINTS: usize = 2;
/// Largest distance of a position from the run's origin, m.
const POSITION_LIMIT_M: f64 = 1e6;
/// Largest speed of a car, m/s.
pub(super) const SPEED_LIMIT_MPS: f64 = 150.0;
/// Largest width of a road, m.
const LATERAL_LIMIT_M: f64 = 1e3;
/// Largest distance of the scanner from the body's centre, m: twice the longest car.
const MOUNT_LIMIT_M: f64 = 60.0;

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
    pub struct Road: 40 bytes {
        /// Distance from the car's centre to the road's left edge, m; negative beyond it.
        pub left_m: f64,
        /// Distance from the car's centre to the road's right edge, m; negative beyond it.
        pub right_m: f64,
        /// Heading of the car in the road frame, rad: positive points left of the lane.
        pub heading_rad: f64,
        /// Offset from the centre of the car's lane, m, positive **left**.
        pub offset_m: f64,
        /// Width of a lane, m: a checkpoint's bend is that of the leftmost lane's centre
        /// line, half of it from the left edge. 0 for a road without lanes, whose bend is
        /// that of its left edge.
        pub lane_width_m: f64,
    }
}

impl Default for Road {
    /// Lanes of the paper's experiment.
    fn default() -> Self {
        Self {
            left_m: 0.0,
            right_m: 0.0,
            heading_rad: 0.0,
            offset_m: 0.0,
            lane_width_m: 3.5,
        }
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
    pub struct Observation: 8464 bytes, nested [Header, Ego, Road, Checkpoint] {
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
        /// How many beams are valid; evenly spaced, their angles are those of
        /// `Observation::fan`.
        pub beam_count: u32,
        /// Angle from the first beam to the last, rad; a full circle from 2π on, whose
        /// first beam looks along the scanner's heading. Else it looks along the right
        /// limit of the field of view. Counter-clockwise.
        pub field_of_view_rad: f64,
        /// Heading of the scanner in the body frame, rad.
        pub scanner_heading_rad: f64,
        /// Where the beams begin, m forward of the car's centre.
        pub scanner_x_body_m: f64,
        /// Where the beams begin, m left of the car's centre.
        pub scanner_y_body_m: f64,
        /// Range of beam k from where the beams begin, m, at most `lidar_max_m`. A beam
        /// at `lidar_max_m` hit nothing, or its return was dropped.
        pub ranges_m: [f32; 2048],
    }
}

const _: () = assert!(
    BEAMS_MAX == 2048 && CHECKPOINTS == 2,
    "as the message declares"
);

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
            field_of_view_rad: TAU,
            scanner_heading_rad: 0.0,
            scanner_x_body_m: 0.0,
            scanner_y_body_m: 0.0,
            ranges_m: [0.0; BEAMS_MAX],
        }
    }
}

impl Message for Observation {
    header_accessors!();

    /// Without the beams that the scanner does not have.
    fn used_bytes(&self) -> usize {
        let beams = (self.beam_count as usize).min(BEAMS_MAX);
        core::mem::offset_of!(Self, ranges_m) + beams * size_of::<f32>()
    }

    /// Without the beams that neither has: 2,048 are 8 kB.
    fn assign(&mut self, from: &Self) {
        let had = self.ranges().len();
        // A new field that is missing here does not compile.
        let &Self {
            header,
            scheduled_ns,
            released_ns,
            published_ns,
            ego,
            road,
            checkpoints,
            lidar_max_m,
            beam_count,
            field_of_view_rad,
            scanner_heading_rad,
            scanner_x_body_m,
            scanner_y_body_m,
            ranges_m: _,
        } = from;
        (self.header, self.ego, self.road) = (header, ego, road);
        (self.scheduled_ns, self.released_ns) = (scheduled_ns, released_ns);
        (self.published_ns, self.checkpoints) = (published_ns, checkpoints);
        (self.lidar_max_m, self.beam_count) = (lidar_max_m, beam_count);
        (self.field_of_view_rad, self.scanner_heading_rad) =
            (field_of_view_rad, scanner_heading_rad);
        (self.scanner_x_body_m, self.scanner_y_body_m) = (scanner_x_body_m, scanner_y_body_m);
        let ranges_m = from.ranges();
        self.ranges_m[..ranges_m.len()].copy_from_slice(ranges_m);
        if let Some(gone) = self.ranges_m.get_mut(ranges_m.len()..had) {
            gone.fill(0.0);
        }
    }

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
        within(
            "road.lane_width_m",
            self.road.lane_width_m,
            0.0..=LATERAL_LIMIT_M,
        )?;
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
        // Two beams of a scan must look in different directions.
        within("field_of_view_rad", self.field_of_view_rad, 1e-3..=7.0)?;
        within("scanner_heading_rad", self.scanner_heading_rad, -PI..=PI)?;
        let mount = -MOUNT_LIMIT_M..=MOUNT_LIMIT_M;
        within("scanner_x_body_m", self.scanner_x_body_m, mount.clone())?;
        within("scanner_y_body_m", self.scanner_y_body_m, mount)?;
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

    /// Where its beams look.
    pub fn fan(&self) -> Fan {
        Fan {
            beams: self.ranges().len(),
            field_of_view_rad: self.field_of_view_rad,
            heading_rad: self.scanner_heading_rad,
            mount_body: Point::new(self.scanner_x_body_m, self.scanner_y_body_m),
        }
    }

    /// Says where the beams of the ranges look.
    pub fn set_fan(&mut self, fan: &Fan) {
        self.beam_count = fan.beams.min(BEAMS_MAX) as u32;
        self.field_of_view_rad = fan.field_of_view_rad;
        self.scanner_heading_rad = fan.heading_rad;
        self.scanner_x_body_m = fan.mount_body.x;
        self.scanner_y_body_m = fan.mount_body.y;
    }
}

impl Checkpoint {
    /// The direction of the bend; an unknown code is read as straight.
    pub fn bend(&self) -> Bend {
        Bend::from_code(self.bend).unwrap_or(Bend::Straight)
    }
}
