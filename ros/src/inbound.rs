//! Messages from ROS, decoded and checked: what passes here is finite, within range and of a
//! bounded size.

use std::f64::consts::TAU;

use vehicle::{Point, Pose, pose};

use crate::cdr::{CdrError, Reader};

/// Most ranges of a scan: of more than any scanner of one plane has.
const RANGES_MAX: usize = 16_384;
/// Most transforms of a message, and most poses of a path.
const TRANSFORMS_MAX: usize = 256;
/// At 5 cm from pose to pose, half a kilometre.
const POSES_MAX: usize = 10_000;
/// Largest coordinate, m, and largest speed, m/s: those of an observation.
const PLACE_MAX_M: f64 = 1e6;
const SPEED_MAX_MPS: f64 = 150.0;
const YAW_RATE_MAX_RADPS: f64 = 100.0;
/// Smallest angle between two beams, rad: a hundredth of that of the finest scanner.
const INCREMENT_MIN_RAD: f64 = 1e-5;
/// Least cosine between two vertical axes that count as parallel: 10 degrees.
const LEVEL_MIN: f64 = 0.985;
/// One range of so many may be an error: a scanner of which more than half fails is broken or
/// covered.
const MEASURED_SHARE: usize = 2;
/// Fewest bytes of a header, and of a pose or transform.
const HEADER_BYTES: usize = 12;
const POSE_BYTES: usize = 56;

/// Why a message is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Refused(pub &'static str);

impl From<CdrError> for Refused {
    fn from(error: CdrError) -> Self {
        Self(match error {
            CdrError::Short => "it is shorter than it says",
            CdrError::Encapsulation => "it is not CDR",
            CdrError::Long => "a list of it is too long",
            CdrError::Text => "a name of it is no text",
        })
    }
}

/// When and in which frame.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// Wall time, ns since the epoch.
    pub stamp_ns: u64,
    /// The frame's name.
    pub frame: String,
}

/// `sensor_msgs/LaserScan`.
#[derive(Debug, Clone, PartialEq)]
pub struct LaserScan {
    /// Its frame is the scanner's.
    pub header: Header,
    /// Direction of the first range, rad counter-clockwise from the frame's x axis.
    pub first_rad: f64,
    /// From range to range, rad; positive.
    pub increment_rad: f64,
    /// Metres; infinity where nothing was met, NaN where nothing was measured.
    pub ranges_m: Vec<f32>,
}

/// `nav_msgs/Odometry`.
#[derive(Debug, Clone, PartialEq)]
pub struct Odometry {
    /// Its frame is the one in which the car moves.
    pub header: Header,
    /// The base frame in it.
    pub pose: Pose,
    /// Forward, m/s.
    pub speed_mps: f64,
    /// Counter-clockwise, rad/s.
    pub yaw_rate_radps: f64,
}

/// One transform of `tf2_msgs/TFMessage`.
#[derive(Debug, Clone, PartialEq)]
pub struct Transform {
    /// Its frame is the parent.
    pub header: Header,
    /// The child's name.
    pub child: String,
    /// The child in the parent, from above; `None` when the two are not level.
    pub pose: Option<Pose>,
}

/// `nav_msgs/Path`.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// Its frame is that of the places.
    pub header: Header,
    /// In order.
    pub places: Vec<Point>,
}

/// A frame's name without the `/` that old senders put before it.
fn frame(text: &str) -> String {
    text.trim_start_matches('/').to_string()
}

fn header(reader: &mut Reader<'_>) -> Result<Header, Refused> {
    let (s, ns) = (reader.i32()?, reader.u32()?);
    let s = u64::try_from(s).map_err(|_| Refused("its stamp is before 1970"))?;
    if ns >= 1_000_000_000 {
        return Err(Refused("its stamp has more than a second of nanoseconds"));
    }
    Ok(Header {
        stamp_ns: s * 1_000_000_000 + u64::from(ns),
        frame: frame(reader.text()?),
    })
}

/// Place and rotation as a pose from above, and whether the vertical axes are parallel.
fn flat(reader: &mut Reader<'_>) -> Result<(Pose, bool), Refused> {
    let [x_m, y_m, z_m] = reader.f64s()?;
    let [x, y, z, w] = reader.f64s()?;
    if ![x_m, y_m, z_m]
        .iter()
        .all(|along_m| along_m.abs() <= PLACE_MAX_M)
    {
        return Err(Refused(
            "a place of it is not a number of metres up to 1,000,000",
        ));
    }
    let norm = x * x + y * y + z * z + w * w;
    // NaN is not within.
    if !(0.9..=1.1).contains(&norm) {
        return Err(Refused("a rotation of it is no unit quaternion"));
    }
    let heading_rad = (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    let is_level = 1.0 - 2.0 * (x * x + y * y) / norm >= LEVEL_MIN;
    Ok((pose(x_m, y_m, heading_rad), is_level))
}

impl LaserScan {
    /// Decodes and checks. By REP 117 infinity met nothing, negative infinity is something too
    /// near to measure, and NaN is an error of the scanner; so is a range below its least. A
    /// range above its greatest met nothing within its limits.
    ///
    /// # Errors
    /// What is wrong with the message.
    pub fn decode(bytes: &[u8]) -> Result<Self, Refused> {
        let mut reader = Reader::new(bytes)?;
        let header = header(&mut reader)?;
        let [first_rad, _last_rad, increment_rad] =
            [reader.f32()?, reader.f32()?, reader.f32()?].map(f64::from);
        let (_time_increment_s, _scan_time_s) = (reader.f32()?, reader.f32()?);
        let (least_m, most_m) = (reader.f32()?, reader.f32()?);
        let count = reader.count(4, RANGES_MAX)?;
        if count == 0 {
            return Err(Refused("it has no range"));
        }
        if !(first_rad.abs() <= TAU && increment_rad.abs() >= INCREMENT_MIN_RAD) {
            return Err(Refused("its angles are no angles"));
        }
        // A full circle may hold the first direction twice.
        let whole_rad = (count - 1) as f64 * increment_rad.abs();
        if !(0.0..=TAU + 1e-3).contains(&whole_rad) {
            return Err(Refused("its ranges are more than a full circle"));
        }
        if !(least_m >= 0.0 && most_m > least_m) {
            return Err(Refused("its least and greatest range are none"));
        }
        let mut ranges_m = Vec::with_capacity(count);
        let mut unmeasured = 0;
        for _ in 0..count {
            ranges_m.push(match reader.f32()? {
                range_m if range_m == f32::NEG_INFINITY => least_m,
                range_m if (least_m..=most_m).contains(&range_m) => range_m,
                range_m if range_m > most_m => f32::INFINITY,
                _ => {
                    unmeasured += 1;
                    f32::NAN
                }
            });
        }
        if unmeasured > count / MEASURED_SHARE {
            return Err(Refused(
                "more than half of its ranges are NaN or below range_min, which are errors of \
                 the scanner (REP 117): a driver has to send inf where nothing is met",
            ));
        }
        // A scanner that turns clockwise, or is read so.
        let is_clockwise = increment_rad < 0.0;
        if is_clockwise {
            ranges_m.reverse();
        }
        Ok(Self {
            header,
            first_rad: match is_clockwise {
                true => first_rad + (count - 1) as f64 * increment_rad,
                false => first_rad,
            },
            increment_rad: increment_rad.abs(),
            ranges_m,
        })
    }
}

impl Odometry {
    /// Decodes and checks.
    ///
    /// # Errors
    /// What is wrong with the message.
    pub fn decode(bytes: &[u8]) -> Result<Self, Refused> {
        let mut reader = Reader::new(bytes)?;
        let header = header(&mut reader)?;
        let _child = reader.text()?;
        let (pose, _) = flat(&mut reader)?;
        let _covariance: [f64; 36] = reader.f64s()?;
        let [speed_mps, _, _, _, _, yaw_rate_radps] = reader.f64s()?;
        // NaN is not within.
        if !(speed_mps.abs() <= SPEED_MAX_MPS && yaw_rate_radps.abs() <= YAW_RATE_MAX_RADPS) {
            return Err(Refused("its speeds are no speeds of a car"));
        }
        Ok(Self {
            header,
            pose,
            speed_mps,
            yaw_rate_radps,
        })
    }
}

impl Transform {
    /// Decodes and checks the transforms of a message; one that is wrong refuses them all.
    ///
    /// # Errors
    /// What is wrong with the message.
    pub fn decode_all(bytes: &[u8]) -> Result<Vec<Self>, Refused> {
        let mut reader = Reader::new(bytes)?;
        let count = reader.count(HEADER_BYTES + POSE_BYTES, TRANSFORMS_MAX)?;
        let mut transforms = Vec::with_capacity(count);
        for _ in 0..count {
            let header = header(&mut reader)?;
            let child = frame(reader.text()?);
            let (pose, is_level) = flat(&mut reader)?;
            transforms.push(Self {
                header,
                child,
                pose: is_level.then_some(pose),
            });
        }
        Ok(transforms)
    }
}

impl Path {
    /// Decodes and checks. The frame of the message counts, not those of its poses.
    ///
    /// # Errors
    /// What is wrong with the message.
    pub fn decode(bytes: &[u8]) -> Result<Self, Refused> {
        let mut reader = Reader::new(bytes)?;
        let own = header(&mut reader)?;
        let count = reader.count(HEADER_BYTES + POSE_BYTES, POSES_MAX)?;
        let mut places = Vec::with_capacity(count);
        for _ in 0..count {
            header(&mut reader)?;
            let (pose, _) = flat(&mut reader)?;
            places.push(pose.translation.vector.into());
        }
        Ok(Self {
            header: own,
            places,
        })
    }
}
