//! The standard messages field by field, except for markers.

use std::borrow::Cow;

use shm_config::message::{Observation, Plan};
use vehicle::Point;

use super::cdr::Cdr;

/// The frame of the world, in which the car moves.
pub const WORLD_FRAME: &str = "map";
/// The frame of the car: x forward, y left, at its middle on the ground.
pub const BODY_FRAME: &str = "base_link";

/// How the frames are named.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Frames {
    /// The one in which the car moves.
    pub world: Cow<'static, str>,
    /// The car's.
    pub body: Cow<'static, str>,
}

impl Default for Frames {
    fn default() -> Self {
        Self {
            world: WORLD_FRAME.into(),
            body: BODY_FRAME.into(),
        }
    }
}

/// The frame of a scanner that is not at the car's middle: x forward, as the car's.
pub const SCANNER_FRAME: &str = "scanner";

/// A frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Frame {
    World,
    Body,
    Scanner,
}

impl Frame {
    fn name(self, frames: &Frames) -> &str {
        match self {
            Self::World => &frames.world,
            Self::Body => &frames.body,
            Self::Scanner => SCANNER_FRAME,
        }
    }
}

/// A time since the epoch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TimeStamp {
    s: i32,
    ns: u32,
}

impl TimeStamp {
    /// Of epoch time, ns. ROS 2 has 31 bits for seconds: a later time stays at their end.
    pub(super) fn of_ns(epoch_ns: u64) -> Self {
        const SECOND_NS: u64 = 1_000_000_000;
        Self {
            s: i32::try_from(epoch_ns / SECOND_NS).unwrap_or(i32::MAX),
            ns: (epoch_ns % SECOND_NS) as u32,
        }
    }
}

/// `std_msgs/Header`.
pub(super) fn header(cdr: &mut Cdr, time: TimeStamp, frame: Frame) {
    cdr.i32(time.s).u32(time.ns);
    cdr.frame(|frames| frame.name(frames));
}

/// The quaternion x, y, z, w of a heading, rad counter-clockwise.
pub(super) fn rotation(heading_rad: f64) -> [f64; 4] {
    let (sin, cos) = (heading_rad / 2.0).sin_cos();
    [0.0, 0.0, sin, cos]
}

fn pose(cdr: &mut Cdr, [x_m, y_m, heading_rad]: [f64; 3]) {
    cdr.f64s([x_m, y_m, 0.0]).f64s(rotation(heading_rad));
}

fn ego_world(observation: &Observation) -> [f64; 3] {
    let ego = &observation.ego;
    [ego.x_world_m, ego.y_world_m, ego.heading_world_rad]
}

/// `tf2_msgs/TFMessage`: where the car is, and where on it a scanner is that is not at
/// its middle.
pub(super) fn transform(cdr: &mut Cdr, time: TimeStamp, observation: &Observation) {
    let scanner = scan_frame(observation) == Frame::Scanner;
    cdr.begin().count(1 + usize::from(scanner));
    header(cdr, time, Frame::World);
    cdr.frame(|frames| &frames.body);
    // A transform has the fields of a pose.
    pose(cdr, ego_world(observation));
    if scanner {
        header(cdr, time, Frame::Body);
        cdr.text(SCANNER_FRAME);
        let mount_body = observation.fan().mount_body;
        pose(cdr, [mount_body.x, mount_body.y, 0.0]);
    }
}

/// The frame in which all beams begin at the origin. The angles of beams are the body's.
fn scan_frame(observation: &Observation) -> Frame {
    match observation.fan().mount_body == Point::origin() {
        true => Frame::Body,
        false => Frame::Scanner,
    }
}

/// `geometry_msgs/PoseStamped`: where the car is.
pub(super) fn ego_pose(cdr: &mut Cdr, time: TimeStamp, observation: &Observation) {
    header(cdr.begin(), time, Frame::World);
    pose(cdr, ego_world(observation));
}

/// `sensor_msgs/LaserScan`. A beam that hits nothing has an infinite range, as REP 117 asks.
pub(super) fn scan(cdr: &mut Cdr, time: TimeStamp, observation: &Observation) {
    let ranges_m = observation.ranges();
    let fan = observation.fan();
    let [first_rad, last_rad] = [0, ranges_m.len().saturating_sub(1)].map(|k| fan.angle_rad(k));
    header(cdr.begin(), time, scan_frame(observation));
    cdr.f32s([first_rad, last_rad, fan.spacing_rad()].map(|angle_rad| angle_rad as f32));
    // All beams are of one instant, and the time between scans is the reader's to see.
    cdr.f32s([0.0, 0.0]).f32s([0.0, observation.lidar_max_m]);
    cdr.count(ranges_m.len());
    for range_m in ranges_m {
        cdr.f32(match *range_m < observation.lidar_max_m {
            true => *range_m,
            false => f32::INFINITY,
        });
    }
    cdr.count(0);
}

/// `nav_msgs/Path`: the waypoints of the plan in the world frame, each with the heading to
/// the next; empty without a plan.
pub(super) fn path(cdr: &mut Cdr, time: TimeStamp, plan: Option<&Plan>) {
    header(cdr.begin(), time, Frame::World);
    let Some(plan) = plan else {
        cdr.count(0);
        return;
    };
    let world_from_plan = vehicle::pose(
        plan.origin_x_world_m,
        plan.origin_y_world_m,
        plan.origin_heading_world_rad,
    );
    let waypoints = plan.waypoints();
    cdr.count(waypoints.len());
    let mut heading_rad = plan.origin_heading_world_rad;
    for (k, waypoint) in waypoints.iter().enumerate() {
        let at_world = world_from_plan * waypoint.point();
        if let Some(next) = waypoints.get(k + 1) {
            let way = world_from_plan * next.point() - at_world;
            heading_rad = way.y.atan2(way.x);
        }
        header(cdr, time, Frame::World);
        pose(cdr, [at_world.x, at_world.y, heading_rad]);
    }
}

/// `sensor_msgs/CompressedImage`.
pub(super) fn picture(cdr: &mut Cdr, time: TimeStamp, (format, data): (&str, &[u8])) {
    header(cdr.begin(), time, Frame::Body);
    cdr.text(format).octets(data);
}

/// What an Ackermann-steered car is asked for.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Drive {
    /// Angle of the front wheels, rad, positive left.
    pub steer_rad: f64,
    /// Speed to reach, m/s.
    pub speed_mps: f64,
    /// Acceleration towards it, m/s².
    pub accel_mps2: f64,
}

/// `ackermann_msgs/AckermannDriveStamped`.
pub(super) fn drive(cdr: &mut Cdr, time: TimeStamp, drive: Drive) {
    header(cdr.begin(), time, Frame::Body);
    // Without limits for the wheels' turning rate and the jerk.
    cdr.f32s([drive.steer_rad as f32, 0.0, drive.speed_mps as f32]);
    cdr.f32s([drive.accel_mps2 as f32, 0.0]);
}

/// How something is, by its code in `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Level {
    Ok = 0,
    Warn = 1,
    Error = 2,
}

/// One `diagnostic_msgs/DiagnosticStatus`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Diagnosis {
    pub(super) level: Level,
    pub(super) name: String,
    pub(super) message: String,
    pub(super) values: Vec<(&'static str, String)>,
}

/// `diagnostic_msgs/DiagnosticArray`.
pub(super) fn diagnostics(cdr: &mut Cdr, time: TimeStamp, all: &[Diagnosis]) {
    header(cdr.begin(), time, Frame::Body);
    cdr.count(all.len());
    for one in all {
        cdr.u8(one.level as u8).text(&one.name).text(&one.message);
        cdr.text("vlaps").count(one.values.len());
        for (key, value) in &one.values {
            cdr.text(key).text(value);
        }
    }
}
