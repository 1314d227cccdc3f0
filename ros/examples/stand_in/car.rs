//! A simulated ROS robot.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;
use std::sync::Mutex;

use robot::{Bicycle, Point};
use vehicle::{Control, Vehicle};
use vlaps_ros::cdr::Reader;
use vlaps_ros::names::TopicType;
use vlaps_ros::wall::Moment;
use zenoh::{Session, Wait};

use super::Failure;

const RADIUS_M: f64 = 40.0;
/// Half of the road's width, m.
const HALF_M: f64 = 5.0;
const BEAMS: u32 = 360;
/// Without a command for so long it brakes, ns.
const SILENT_NS: u64 = 250_000_000;
/// Calls from scan to scan: 20 Hz.
const SCAN_CALLS: u64 = 10;

/// When a command came, its angle and its speed.
type Asked = Arc<Mutex<Option<(u64, f64, f64)>>>;

/// The car on its ring.
pub struct Car {
    bicycle: Bicycle,
    router: Session,
    topics: [(String, &'static str); 4],
    asked: Asked,
    calls: u64,
}

impl Car {
    /// On the ring's right end, looking along it.
    pub fn new(router: Session) -> Result<Self, Failure> {
        let mut bicycle = Bicycle::new(Vehicle::default());
        bicycle.place(Point::new(RADIUS_M, 0.0), FRAC_PI_2);
        let key = |topic: &str, short: &str| {
            let of = TopicType::standard(short)?;
            Ok::<_, String>(format!("0/{topic}/{}/{}", of.dds_name(), of.hash))
        };
        let topics = [
            (key("scan", "sensor_msgs/LaserScan")?, "scan"),
            (key("odom", "nav_msgs/Odometry")?, "odom"),
            (key("tf", "tf2_msgs/TFMessage")?, "tf"),
            (key("plan", "nav_msgs/Path")?, "plan"),
        ];
        let asked = Asked::default();
        let hears = asked.clone();
        router
            .declare_subscriber(key("drive", "ackermann_msgs/AckermannDriveStamped")?)
            .callback(move |sample| {
                let bytes = sample.payload().to_bytes();
                if let (Some((angle_rad, speed_mps)), Ok(mut asked)) =
                    (command(&bytes), hears.lock())
                {
                    *asked = Some((Moment::now().now.0, angle_rad, speed_mps));
                }
            })
            .background()
            .wait()?;
        Ok(Self {
            bicycle,
            router,
            topics,
            asked,
            calls: 0,
        })
    }

    /// Moves, and publishes what its sensors see.
    pub fn advance(&mut self, moment: Moment, step_s: f64) -> Result<(), Failure> {
        let asked = self.asked.lock().ok().and_then(|asked| *asked);
        let asked = asked.filter(|(at_ns, ..)| moment.now.0 - at_ns < SILENT_NS);
        let (_, steer_rad, wanted_mps) = asked.unwrap_or_default();
        let vehicle = self.bicycle.vehicle;
        let gap_mps = wanted_mps - self.bicycle.state.speed_mps;
        let accel_mps2 = (gap_mps / step_s).clamp(-vehicle.max_brake_mps2, vehicle.max_accel_mps2);
        let control = Control {
            steer_rad,
            accel_mps2,
        };
        self.bicycle.advance(control.action(&vehicle), step_s);
        if self.calls.is_multiple_of(SCAN_CALLS) {
            self.publish(moment)?;
        }
        self.calls += 1;
        Ok(())
    }

    fn publish(&self, moment: Moment) -> Result<(), Failure> {
        let state = &self.bicycle.state;
        let (place, heading_rad) = (state.position, state.heading_rad);
        for (key, topic) in &self.topics {
            let to = Cdr::default();
            let cdr = match *topic {
                "scan" => self.scan(to.header(moment, "laser")),
                "odom" => to
                    .header(moment, "odom")
                    .text("base_link")
                    .pose(place, heading_rad)
                    .f64s(&[0.0; 36])
                    .f64s(&[state.speed_mps, 0.0, 0.0, 0.0, 0.0, 0.0])
                    .f64s(&[0.0; 36]),
                "tf" => to
                    .u32(1)
                    .header(moment, "base_link")
                    .text("laser")
                    .pose(Point::origin(), 0.0),
                // Once a second.
                _ if !self.calls.is_multiple_of(200) => continue,
                _ => ring(to.header(moment, "odom"), moment),
            };
            self.router.put(key, cdr.0).wait()?;
        }
        Ok(())
    }

    fn scan(&self, to: Cdr) -> Cdr {
        let turn_rad = TAU / f64::from(BEAMS);
        let angles = [-TAU / 2.0, TAU / 2.0 - turn_rad, turn_rad];
        let to = angles.iter().fold(to, |to, angle_rad| to.f32(*angle_rad));
        let to = [0.0, 0.05, 0.1, 60.0]
            .iter()
            .fold(to, |to, value| to.f32(*value));
        let ranges = (0..BEAMS).map(|k| self.range_m(f64::from(k) * turn_rad - TAU / 2.0));
        ranges.fold(to.u32(BEAMS), Cdr::f32).u32(0)
    }

    /// Distance to the nearest wall in a direction from the heading, m.
    fn range_m(&self, direction_rad: f64) -> f64 {
        let (sin, cos) = (self.bicycle.state.heading_rad + direction_rad).sin_cos();
        let place = self.bicycle.state.position.coords;
        let along = place.x * cos + place.y * sin;
        // Where |place + t * direction| is a wall's radius.
        let root = |wall_m: f64| (along * along - place.norm_squared() + wall_m * wall_m).sqrt();
        match -along - root(RADIUS_M - HALF_M) {
            inner_m if inner_m > 0.0 => inner_m,
            _ => -along + root(RADIUS_M + HALF_M),
        }
    }
}

/// The ring's middle as a path.
fn ring(to: Cdr, moment: Moment) -> Cdr {
    const PIECES: u32 = 360;
    (0..PIECES).fold(to.u32(PIECES), |to, k| {
        let angle_rad = TAU * f64::from(k) / f64::from(PIECES);
        let place = Point::new(angle_rad.cos(), angle_rad.sin()) * RADIUS_M;
        to.header(moment, "odom").pose(place, angle_rad + FRAC_PI_2)
    })
}

/// Angle and speed of `ackermann_msgs/AckermannDriveStamped`.
fn command(bytes: &[u8]) -> Option<(f64, f64)> {
    let mut reader = Reader::new(bytes).ok()?;
    let (_s, _ns, _frame) = (reader.u32().ok()?, reader.u32().ok()?, reader.text().ok()?);
    let (angle_rad, _) = (reader.f32().ok()?, reader.f32().ok()?);
    Some((angle_rad.into(), reader.f32().ok()?.into()))
}

/// CDR as another program writes it.
struct Cdr(Vec<u8>);

impl Default for Cdr {
    fn default() -> Self {
        Self(vec![0, 1, 0, 0])
    }
}

impl Cdr {
    fn put<const N: usize>(mut self, bytes: [u8; N]) -> Self {
        let to = 4 + (self.0.len() - 4).next_multiple_of(N);
        self.0.resize(to, 0);
        self.0.extend(bytes);
        self
    }

    fn u32(self, value: u32) -> Self {
        self.put(value.to_le_bytes())
    }

    fn f32(self, value: f64) -> Self {
        self.put((value as f32).to_le_bytes())
    }

    fn f64s(self, values: &[f64]) -> Self {
        values
            .iter()
            .fold(self, |to, value| to.put(value.to_le_bytes()))
    }

    fn text(self, text: &str) -> Self {
        let mut to = self.u32(text.len() as u32 + 1);
        to.0.extend(text.as_bytes());
        to.0.push(0);
        to
    }

    fn header(self, moment: Moment, frame: &str) -> Self {
        let (s, ns) = (
            moment.epoch_ns / 1_000_000_000,
            moment.epoch_ns % 1_000_000_000,
        );
        self.u32(s as u32).u32(ns as u32).text(frame)
    }

    fn pose(self, place: Point, heading_rad: f64) -> Self {
        let (sin, cos) = (heading_rad / 2.0).sin_cos();
        self.f64s(&[place.x, place.y, 0.0, 0.0, 0.0, sin, cos])
    }
}
