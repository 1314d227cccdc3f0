//! Messages in: each is checked and dated, and left for the tick. All of this is in Zenoh's
//! threads, which have no real-time priority.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use shm_config::Instant;
use shm_config::config::Config;
use triple_buffer::Input;
use vehicle::{Fan, Point, pose};
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::sample::Sample;
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, HistoryConfig};

use super::lay::{Laying, Road};
use super::robot::{Course, Moved, Seen, Slots};
use super::sweep::Sweep;
use crate::frames::{Frames, Place};
use crate::inbound::{Header, LaserScan, Odometry, Path, Refused, Transform};
use crate::lines::Lines;
use crate::names::{End, TopicType, type_of_key};
use crate::session::{Link, first};
use crate::settings::{Settings, Stamps};
use crate::wall::Moment;

/// Longest message that is looked at, bytes: a path of 10,000 poses with long frame names.
const PAYLOAD_MAX: usize = 4 << 20;
/// A stamp may be this far in the future, ns: clocks of two machines differ.
const FUTURE_NS: i64 = 50_000_000;
/// How long the transform of the scanner is waited for after the first scan, ns.
const TRANSFORM_NS: u64 = 2_000_000_000;
/// How far TF and `[scanner]` may differ in where the scanner is, m.
const MOUNT_MAX_M: f64 = 0.05;
/// A topic without a message that can be used is told after this time, ns.
const SILENT_NS: u64 = 1_000_000_000;

/// What all messages need.
pub struct Ears {
    base_frame: String,
    settings: crate::settings::Robot,
    fan: Fan,
    sweep: Sweep,
    road: Road,
    lines: Lines,
    frames: Mutex<Frames>,
    /// The frame of the odometry, and the number of times that it has changed.
    world_frame: Mutex<(String, u64)>,
    /// When the first scan came.
    begun: Mutex<Option<Instant>>,
    path: Mutex<Laying>,
    /// When the last scan and the last odometry came that could be used.
    scan_ns: AtomicU64,
    odometry_ns: AtomicU64,
    seen: Mutex<Input<Seen>>,
    moved: Mutex<Input<Moved>>,
    course: Mutex<Input<Course>>,
}

/// The subscriptions of a session, and that others see them.
pub type Subscribed = Vec<(AdvancedSubscriber<()>, LivelinessToken)>;

/// A lock whose holder panicked guards valid data: each is written whole.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Ears {
    /// For a run with this configuration.
    pub fn new(config: &Config, settings: &Settings, slots: Slots) -> Self {
        let fan = config.scanner.fan();
        let road = Road {
            half_width_m: settings.robot.half_width_m(&config.vehicle),
            is_closed: settings.robot.closed_path,
        };
        Self {
            base_frame: settings.base_frame.clone(),
            settings: settings.robot.clone(),
            fan,
            sweep: Sweep::new(fan, config.scanner.range_m, config.vehicle.width_m),
            road,
            lines: Lines::default(),
            frames: Mutex::default(),
            world_frame: Mutex::default(),
            begun: Mutex::default(),
            path: Mutex::default(),
            scan_ns: AtomicU64::new(Moment::now().now.0),
            odometry_ns: AtomicU64::new(Moment::now().now.0),
            seen: Mutex::new(slots.seen),
            moved: Mutex::new(slots.moved),
            course: Mutex::new(slots.course),
        }
    }

    /// Subscribes to all topics of the robot.
    ///
    /// # Errors
    /// When the session is closed, or a name is none.
    pub fn subscribe(self: &Arc<Self>, link: &mut Link) -> Result<Subscribed, String> {
        let names = &self.settings;
        let (now, late) = (End::Subscription, End::LateSubscription);
        let scan = ("scan", names.scan.as_str(), "sensor_msgs/LaserScan", now);
        let odometry = (
            "odometry",
            names.odometry.as_str(),
            "nav_msgs/Odometry",
            now,
        );
        let moving = ("TF", "/tf", "tf2_msgs/TFMessage", now);
        let fixed = ("TF", "/tf_static", "tf2_msgs/TFMessage", late);
        let path = ("path", names.path.as_str(), "nav_msgs/Path", late);
        let mut all = vec![
            self.listen(link, scan, Self::scan)?,
            self.listen(link, odometry, Self::odometry)?,
            self.listen(link, moving, Self::transforms)?,
            self.listen(link, fixed, Self::transforms)?,
        ];
        if !names.path.is_empty() {
            all.push(self.listen(link, path, Self::path)?);
        }
        Ok(all)
    }

    /// Subscribes to a topic under any type: a sender of another type is told, where a
    /// subscription to the own type alone would hear nothing.
    fn listen(
        self: &Arc<Self>,
        link: &mut Link,
        (what, topic, short, end): (&'static str, &str, &str, End),
        hear: Hear,
    ) -> Result<(AdvancedSubscriber<()>, LivelinessToken), String> {
        let of = TopicType::standard(short)?;
        let endpoint = link.node.endpoint(topic, &of, end)?;
        let any = endpoint.key.rsplitn(3, '/').last().unwrap_or_default();
        let builder = link.session.declare_subscriber(format!("{any}/*/*"));
        let (ears, dds_name, topic) = (self.clone(), of.dds_name(), topic.to_string());
        let hear = move |sample: Sample| {
            let moment = Moment::now();
            let heard = check_type(&sample, (&dds_name, &of.hash))
                .and_then(|()| hear(&ears, &payload(&sample)?, moment));
            if let Err(refused) = heard {
                ears.tell(
                    (what, &topic),
                    refused,
                    (sample.key_expr().as_str(), moment),
                );
            }
        };
        let subscriber = match end {
            End::LateSubscription => builder
                .callback(hear)
                .history(HistoryConfig::default().detect_late_publishers())
                .wait(),
            End::Publisher | End::Subscription => builder.callback(hear).advanced().wait(),
        };
        let subscriber = subscriber.map_err(|error| first(&error))?;
        Ok((subscriber, link.show(&endpoint)?))
    }

    /// One line for a kind of refusal.
    fn tell(
        &self,
        (what, topic): (&'static str, &str),
        refused: Refused,
        (key, moment): (&str, Moment),
    ) {
        let Some(since) = self.lines.note(what, refused.0, moment.now) else {
            return;
        };
        let again = match since {
            0 => String::new(),
            since => format!(" ({since} more since the last line)"),
        };
        match (refused, type_of_key(key)) {
            (OTHER_TYPE, Some((name, hash))) => tracing::warn!(
                "{what}: {topic} comes as {name} {hash}, {}; refused{again}",
                refused.0
            ),
            _ => tracing::warn!(
                "{what}: a message on {topic} is refused: {}{again}",
                refused.0
            ),
        }
    }

    /// When a message was taken, on the run's clock.
    fn taken(&self, header: &Header, moment: Moment) -> Result<Instant, Refused> {
        if self.settings.stamps == Stamps::Arrival {
            return Ok(moment.now);
        }
        let age_ns = moment.age_ns(header.stamp_ns);
        if age_ns < -FUTURE_NS {
            return Err(Refused(
                "its stamp is in the future by the wall clock; do both machines have the same \
                 time? robot.stamps = \"arrival\" ignores stamps",
            ));
        }
        let age_ns = age_ns.max(0) as u64;
        if age_ns as f64 > self.settings.age_ms * 1e6 {
            return Err(Refused(
                "its stamp is older than robot.age_ms by the wall clock; do both machines have \
                 the same time? robot.stamps = \"arrival\" ignores stamps",
            ));
        }
        Ok(Instant(moment.now.0.saturating_sub(age_ns)))
    }

    fn scan(&self, bytes: &[u8], moment: Moment) -> Result<(), Refused> {
        let scan = LaserScan::decode(bytes)?;
        let taken = self.taken(&scan.header, moment)?;
        let begun = *lock(&self.begun).get_or_insert(moment.now);
        let place = lock(&self.frames).place(&scan.header.frame, &self.base_frame);
        let heading_rad = match place {
            Place::Known(base_from_scanner) => {
                let body_from_base = pose(self.settings.base_x_m, 0.0, 0.0);
                let body_from_scanner = body_from_base * base_from_scanner;
                let at_body: Point = body_from_scanner.translation.vector.into();
                if (at_body - self.fan.mount_body).norm() > MOUNT_MAX_M {
                    return Err(Refused(
                        "TF says that the scanner is elsewhere than x_m and y_m of [scanner], \
                         or robot.base_x_m is not where the base frame is",
                    ));
                }
                body_from_scanner.rotation.angle()
            }
            Place::Tilted => return Err(Refused("by TF the scanner is not level")),
            // The transforms may still be on their way.
            Place::Unknown if moment.now.since_ns(begun) < TRANSFORM_NS => return Ok(()),
            Place::Unknown => {
                let kind = "TF does not say where the scanner is; [scanner] does";
                if self.lines.note("scan", kind, moment.now).is_some() {
                    tracing::info!("scan: {kind}");
                }
                self.fan.heading_rad
            }
        };
        let mut seen = lock(&self.seen);
        // A scan that is refused half-way is not published.
        let into = seen.input_buffer_mut();
        into.taken = Some(taken);
        self.sweep.fill(&scan, heading_rad, &mut into.ranges_m)?;
        seen.publish();
        self.scan_ns.store(moment.now.0, Ordering::Relaxed);
        Ok(())
    }

    fn odometry(&self, bytes: &[u8], moment: Moment) -> Result<(), Refused> {
        let odometry = Odometry::decode(bytes)?;
        let taken = self.taken(&odometry.header, moment)?;
        let frame = {
            let mut frame = lock(&self.world_frame);
            if frame.0 != odometry.header.frame {
                *frame = (odometry.header.frame, frame.1 + 1);
            }
            frame.1
        };
        // The car's centre moves as the base frame does, on the line through both.
        let centre_x_m = -self.settings.base_x_m;
        lock(&self.moved).write(Moved {
            taken: Some(taken),
            frame,
            pose: odometry.pose * pose(centre_x_m, 0.0, 0.0),
            speed_mps: odometry.speed_mps,
            yaw_rate_radps: odometry.yaw_rate_radps,
        });
        self.odometry_ns.store(moment.now.0, Ordering::Relaxed);
        Ok(())
    }

    fn transforms(&self, bytes: &[u8], _moment: Moment) -> Result<(), Refused> {
        let transforms = Transform::decode_all(bytes)?;
        lock(&self.frames).note(transforms)
    }

    /// A path has no age: it holds until the next.
    fn path(&self, bytes: &[u8], _moment: Moment) -> Result<(), Refused> {
        lock(&self.path).note(Path::decode(bytes)?);
        Ok(())
    }

    /// One line for a topic that is silent.
    pub fn tell_silence(&self, moment: Moment) {
        let topics = [
            ("scan", &self.settings.scan, &self.scan_ns),
            ("odometry", &self.settings.odometry, &self.odometry_ns),
        ];
        for (what, topic, last_ns) in topics {
            let last = Instant(last_ns.load(Ordering::Relaxed));
            let is_silent = moment.now.since_ns(last) > SILENT_NS;
            if is_silent && self.lines.note(what, "silent", moment.now).is_some() {
                tracing::warn!("{what}: nothing usable on {topic} for 1 s; the car brakes");
            }
        }
    }

    /// Makes a route of the newest path, when it or its place in the odometry's frame has
    /// changed. Called ten times a second.
    pub fn lay_route(&self, moment: Moment) {
        let mut laying = lock(&self.path);
        let (world_frame, frame) = lock(&self.world_frame).clone();
        // Before the first odometry there is nothing to lay it into.
        if frame == 0 {
            return;
        }
        let place = |of: &str| lock(&self.frames).place(of, &world_frame);
        let Some(laid) = laying.lay((frame, place), self.road) else {
            return;
        };
        let topic = &self.settings.path;
        if let Err(refused) = &laid {
            self.tell(("path", topic), *refused, ("", moment));
        }
        lock(&self.course).write(Course {
            number: laying.number(),
            frame,
            route: laid.unwrap_or_default(),
        });
    }
}

/// Hears one message.
type Hear = fn(&Ears, &[u8], Moment) -> Result<(), Refused>;

/// The refusal of a message of another type.
const OTHER_TYPE: Refused = Refused("a type that this program was not built with");

/// Refuses a message that is published under another type or version of it.
fn check_type(sample: &Sample, own: (&str, &str)) -> Result<(), Refused> {
    match type_of_key(sample.key_expr().as_str()) == Some(own) {
        true => Ok(()),
        false => Err(OTHER_TYPE),
    }
}

/// The bytes of a message, if there are not too many.
fn payload(sample: &Sample) -> Result<std::borrow::Cow<'_, [u8]>, Refused> {
    match sample.payload().len() <= PAYLOAD_MAX {
        true => Ok(sample.payload().to_bytes()),
        false => Err(Refused("it is longer than 4 MB")),
    }
}
