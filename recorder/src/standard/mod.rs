//! Topics of standard ROS 2 types, made from the recorded messages, for viewers that do not
//! know ours: Foxglove, Lichtblick, Rerun.
//!
//! | topic | type | frame |
//! |---|---|---|
//! | `/tf` | `tf2_msgs/TFMessage` | `map` to `base_link` |
//! | `/ros/pose` | `geometry_msgs/PoseStamped` | `map` |
//! | `/ros/plan` | `nav_msgs/Path` | `map` |
//! | `/ros/scan` | `sensor_msgs/LaserScan` | `base_link` |
//! | `/ros/scene` | `visualization_msgs/MarkerArray` | `base_link` |
//! | `/ros/tree` | `visualization_msgs/MarkerArray` | `base_link` |
//! | `/ros/picture` | `sensor_msgs/CompressedImage` | `base_link` |
//! | `/diagnostics` | `diagnostic_msgs/DiagnosticArray` | |
//!
//! Stamps are those of the observation that is shown, in epoch time. What a viewer shows is
//! for people: replay and comparison read our own messages.

mod branches;
mod cdr;
mod definitions;
mod diagnoses;
mod geometry;
mod markers;
mod messages;
mod topic;

use std::collections::BTreeMap;

use image::ExtendedColorType;
use image::codecs::jpeg::JpegEncoder;
use planner::Planner;
use shm_config::Message as _;
use shm_config::config::Config;
use shm_config::config::planner::Method;
use shm_config::layout::Layout as _;
use shm_config::message::{Assessment, Driver, Frame, Health, PixelFormat, Plan, Proposal, Step};
use shm_config::palette;
use shm_config::services::{FRAME, Process, STEP, health};
use vehicle::Point;

pub use branches::{Branch, branches};
use cdr::Cdr;
pub use definitions::definition;
pub use geometry::{Bodies, Body, edges, rollout};
use markers::{Kind, Marker, VETOED};
use messages::TimeStamp;
pub use messages::{BODY_FRAME, Drive, Frames, WORLD_FRAME};
pub use topic::{Topic, Wanted};

/// Time between two diagnoses, and between two search trees, ns: each tree is a search.
const SLOWLY_NS: u64 = 1_000_000_000;
/// Quality of pictures, in percent.
const QUALITY: u8 = 85;

/// Takes a topic's message as CDR.
pub type Take<'a> = &'a mut dyn FnMut(Topic, &[u8]);

/// Makes the standard messages of successive steps.
#[derive(Debug)]
pub struct Standard {
    config: Config,
    /// Epoch time minus the run's clock, ns.
    epoch_offset_ns: u64,
    period_ns: u64,
    due_ns: u64,
    slowly_due_ns: u64,
    bodies: Bodies,
    /// Searches again for the tree; `None` for methods without one, or whose search depends
    /// on what was before.
    planner: Option<Planner>,
    plan: Box<Plan>,
    /// Memory for a step that is due.
    step: Option<Box<Step>>,
    healths: BTreeMap<&'static str, (Process, Health)>,
    wanted: Wanted,
    cdr: Cdr,
}

impl Standard {
    /// For the steps of a run with this configuration, at most `rate_hz` of them a second.
    pub fn new(config: &Config, epoch_offset_ns: u64, rate_hz: f64) -> Self {
        let has_tree = matches!(config.planner.method, Method::RrtStar | Method::Kinodynamic);
        // A configuration that ran has a planner; without one, there is no tree.
        let planner = has_tree.then(|| Planner::new(config).ok()).flatten();
        Self {
            config: config.clone(),
            epoch_offset_ns,
            period_ns: (1e9 / rate_hz) as u64,
            due_ns: 0,
            slowly_due_ns: 0,
            bodies: Bodies::default(),
            planner,
            plan: Box::default(),
            step: None,
            healths: BTreeMap::new(),
            wanted: Wanted::ALL,
            cdr: Cdr::default(),
        }
    }

    /// Names the frames otherwise.
    pub fn set_frames(&mut self, frames: Frames) {
        self.cdr.frames = frames;
    }

    /// From now on epoch time minus the run's clock is this, ns.
    pub fn set_epoch_offset(&mut self, epoch_offset_ns: u64) {
        self.epoch_offset_ns = epoch_offset_ns;
    }

    /// From now on only these topics are made; at first, all are. What nothing reads costs no
    /// search tree and no JPEG then.
    pub fn set_wanted(&mut self, wanted: Wanted) {
        self.wanted = wanted;
    }

    /// Gives what follows from a message of a service that was taken at this time of the
    /// run's clock, if it is due; `memory` is that of the message.
    pub fn message(&mut self, (service, taken_ns): (&str, u64), memory: &[u8], take: Take<'_>) {
        if service == STEP.name {
            // Most steps are not due, and copying one costs more than its look.
            if self.wanted.needs_steps() && self.is_due(taken_ns) {
                let mut step = self.step.take().unwrap_or_default();
                if step.copy_from(memory) {
                    self.step(&step, take);
                }
                self.step = Some(step);
            }
        } else if service == FRAME.name {
            if self.wanted.has(Topic::Picture)
                && let Some(picture) = picture(memory)
            {
                self.frame(taken_ns, picture, take);
            }
        } else if service.starts_with("health/")
            && let Some(message) = Health::from_bytes(memory)
        {
            let process = Process::ALL.iter().find(|of| health(**of).name == service);
            if let Some(process) = process {
                self.note(*process, &message);
            }
        }
    }

    fn stamp(&self, taken_ns: u64) -> TimeStamp {
        TimeStamp::of_ns(taken_ns.saturating_add(self.epoch_offset_ns))
    }

    /// Notes the health of a process.
    pub fn note(&mut self, process: Process, health: &Health) {
        self.healths.insert(process.word(), (process, *health));
    }

    /// Whether a step that was taken at this time of the run's clock is due.
    pub fn is_due(&self, taken_ns: u64) -> bool {
        // A clock that goes back is that of another start of the controller.
        taken_ns >= self.due_ns || taken_ns.saturating_add(self.period_ns) < self.due_ns
    }

    /// Gives the messages of a step if they are due; none of a step that is refused.
    pub fn step(&mut self, step: &Step, take: Take<'_>) {
        let now_ns = step.header.taken_ns;
        if !self.is_due(now_ns) || step.check().is_err() {
            return;
        }
        // On the grid of the rate, so that a period that does not divide the tick's is kept
        // on average.
        let next_ns = self.due_ns.saturating_add(self.period_ns);
        self.due_ns = match next_ns > now_ns && self.due_ns <= now_ns {
            true => next_ns,
            false => now_ns.saturating_add(self.period_ns),
        };
        let is_slow_due =
            now_ns >= self.slowly_due_ns || now_ns.saturating_add(SLOWLY_NS) < self.slowly_due_ns;
        let wanted = self.wanted;
        if is_slow_due {
            self.slowly_due_ns = now_ns.saturating_add(SLOWLY_NS);
            if wanted.has(Topic::Diagnostics) {
                self.diagnose(step, take);
            }
        }
        // A step without an observation shows nothing.
        if step.observation_age_ns == u64::MAX {
            return;
        }
        let observation = &step.observation;
        let time = self.stamp(observation.header.taken_ns);
        let cdr = &mut self.cdr;
        if wanted.has(Topic::Transform) {
            messages::transform(cdr, time, observation);
            take(Topic::Transform, cdr.bytes());
        }
        if wanted.has(Topic::Pose) {
            messages::ego_pose(cdr, time, observation);
            take(Topic::Pose, cdr.bytes());
        }
        if wanted.has(Topic::Plan) {
            let plan = (step.plan_age_ns != u64::MAX).then_some(&step.plan);
            messages::path(cdr, time, plan);
            take(Topic::Plan, cdr.bytes());
        }
        if wanted.has(Topic::Scan) {
            messages::scan(cdr, time, observation);
            take(Topic::Scan, cdr.bytes());
        }
        if wanted.has(Topic::Scene) {
            self.bodies.follow(step);
            let scene = scene(&self.config, &self.bodies, step);
            markers::write(cdr, time, &scene);
            take(Topic::Scene, cdr.bytes());
        }
        if is_slow_due && wanted.has(Topic::Tree) {
            self.tree(step, time, take);
        }
    }

    /// Searches again for the step's observation, and gives the tree.
    fn tree(&mut self, step: &Step, time: TimeStamp, take: Take<'_>) {
        let Some(planner) = &mut self.planner else {
            return;
        };
        planner.plan(&step.observation, &mut self.plan);
        // A free way to the goal needs no search, and leaves the tree of an earlier one.
        let branches = match self.plan.iterations {
            0 => Vec::new(),
            _ => branches(planner).unwrap_or_default(),
        };
        let ways = branches.iter().map(|branch| branch.way_body.as_slice());
        let points: Vec<Point> = ways.flat_map(markers::lines).collect();
        let color = (palette::LINE_BROKEN, 0.4);
        let tree = Marker::of_points(("tree", 0, Kind::LineList), color, 0.05, points);
        markers::write(&mut self.cdr, time, &[tree]);
        take(Topic::Tree, self.cdr.bytes());
    }

    fn diagnose(&mut self, step: &Step, take: Take<'_>) {
        let now_ns = step.header.taken_ns;
        let mut all = vec![diagnoses::drive(step)];
        // In lockstep their clock is the machine's, and silence cannot be told.
        let age_ns = |health: &Health| match self.config.run.is_lockstep() {
            true => 0,
            false => now_ns.saturating_sub(health.header.taken_ns),
        };
        let healths = self.healths.values();
        all.extend(healths.map(|(of, health)| diagnoses::process(*of, health, age_ns(health))));
        let time = self.stamp(now_ns);
        messages::diagnostics(&mut self.cdr, time, &all);
        take(Topic::Diagnostics, self.cdr.bytes());
    }

    /// Gives a picture of this time of the run's clock: width, height, and red, green and
    /// blue of each pixel from the top left.
    pub fn frame(
        &mut self,
        taken_ns: u64,
        (width, height, rgb): (u32, u32, &[u8]),
        take: Take<'_>,
    ) {
        // The encoder takes no other.
        if rgb.len() as u64 != Frame::bytes([width, height]) {
            return;
        }
        let mut jpeg = Vec::new();
        let mut encoder = JpegEncoder::new_with_quality(&mut jpeg, QUALITY);
        let pixel = ExtendedColorType::Rgb8;
        // A side of 0 or of more than 65,535 pixels is refused.
        if encoder.encode(rgb, width, height, pixel).is_ok() {
            self.picture(taken_ns, ("jpeg", &jpeg), take);
        }
    }

    /// Gives an encoded picture of this time of the run's clock; its format is `jpeg` or
    /// `png`.
    pub fn picture(&mut self, taken_ns: u64, picture: (&str, &[u8]), take: Take<'_>) {
        let time = self.stamp(taken_ns);
        messages::picture(&mut self.cdr, time, picture);
        take(Topic::Picture, self.cdr.bytes());
    }
}

/// `ackermann_msgs/AckermannDriveStamped` of an epoch time, ns, for the car whose frame has
/// this name.
pub fn drive_cdr(epoch_ns: u64, body_frame: &str, drive: Drive) -> Vec<u8> {
    let mut cdr = Cdr::default();
    cdr.frames.body = body_frame.to_string().into();
    messages::drive(&mut cdr, TimeStamp::of_ns(epoch_ns), drive);
    cdr.bytes().to_vec()
}

/// Width, height and pixels of a frame in memory; `None` when it holds no whole picture.
/// Field by field: a frame of two megabytes is not copied.
fn picture(memory: &[u8]) -> Option<(u32, u32, &[u8])> {
    let field = |name: &str| {
        let field = Frame::FIELDS.iter().find(|field| field.name == name)?;
        memory.get(field.offset..field.offset + field.size)
    };
    let number = |name: &str| Some(u32::from_le_bytes(field(name)?.try_into().ok()?));
    let (width, height) = (number("width")?, number("height")?);
    let PixelFormat::Rgb8 = PixelFormat::from_code(number("format")?)?;
    let bytes = usize::try_from(Frame::bytes([width, height])).ok()?;
    let pixels = field("pixels")?.get(..bytes)?;
    Some((width, height, pixels))
}

/// Road, checkpoints, car, bodies that move, both rollouts, and who drives.
fn scene(config: &Config, bodies: &Bodies, step: &Step) -> Vec<Marker> {
    let observation = &step.observation;
    let [left, right] = edges(observation);
    let line = (palette::LINE_SOLID, 0.9);
    let ahead = observation.checkpoints.iter();
    let ahead = ahead.map(|checkpoint| Point::new(checkpoint.x_body_m, checkpoint.y_body_m));
    let (mut circles, mut arrows) = (Vec::new(), Vec::new());
    for body in bodies.moving() {
        circles.extend(markers::circle(body.at, body.radius_m));
        arrows.extend([body.at, body.at + body.velocity_mps]);
    }
    let moving = (palette::VEHICLE, 1.0);
    let driver = palette::driver(step.driver());
    let reason = step.reason().map_or("unknown", |reason| reason.word());
    let speed_mps = observation.ego.speed_mps;
    let label = format!("{}: {reason}, {speed_mps:.1} m/s", step.driver().word());
    let car = config.vehicle.footprint();
    vec![
        Marker::of_points(("road", 0, Kind::LineStrip), line, 0.15, left),
        Marker::of_points(("road", 1, Kind::LineStrip), line, 0.15, right),
        Marker::of_points(
            ("checkpoints", 0, Kind::SphereList),
            (palette::LINE_CENTRE, 0.8),
            0.8,
            ahead.collect(),
        ),
        Marker::car(car.length_m, car.width_m, driver),
        Marker::label(label, driver),
        Marker::of_points(("tracks", 0, Kind::LineList), moving, 0.15, circles),
        Marker::of_points(("tracks", 1, Kind::LineList), moving, 0.25, arrows),
        held(config, step, Driver::Expert),
        held(config, step, Driver::Policy),
    ]
}

/// The rollout of one proposal; red when it is vetoed, empty without one.
fn held(config: &Config, step: &Step, driver: Driver) -> Marker {
    let (group, proposal, assessment): (_, &Proposal, &Assessment) = match driver {
        Driver::Policy => ("policy", &step.policy, &step.policy_assessment),
        Driver::Expert | Driver::Brake => ("expert", &step.expert, &step.expert_assessment),
    };
    let speed_mps = step.observation.ego.speed_mps;
    let path = proposal
        .action()
        .map(|action| rollout(config, action, speed_mps));
    let color = match assessment.is_vetoed() {
        true => VETOED,
        false => palette::driver(driver),
    };
    let path = path.unwrap_or_default();
    Marker::of_points((group, 0, Kind::LineStrip), (color, 1.0), 0.2, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The memory of a frame that claims this width and height.
    fn claiming(sides: [u32; 2]) -> Vec<u8> {
        let mut memory = vec![0; size_of::<Frame>()];
        for (name, side) in ["width", "height"].into_iter().zip(sides) {
            let field = Frame::FIELDS.iter().find(|field| field.name == name);
            let at = field.expect("a field").offset;
            memory[at..at + 4].copy_from_slice(&side.to_le_bytes());
        }
        memory
    }

    /// The topics that a step and a picture give while these are wanted.
    fn given(wanted: Wanted) -> Vec<Topic> {
        let mut step = Box::new(Step::default());
        step.header.taken_ns = 5_000_000_000;
        (step.observation_age_ns, step.plan_age_ns) = (0, 0);
        let mut standard = Standard::new(&Config::default(), 0, 10.0);
        standard.set_wanted(wanted);
        let mut given = Vec::new();
        let mut take = |topic, _: &[u8]| given.push(topic);
        standard.message((STEP.name, 5_000_000_000), step.as_bytes(), &mut take);
        let frame = claiming([8, 6]);
        standard.message((FRAME.name, 5_000_000_000), &frame, &mut take);
        given
    }

    #[test]
    fn what_is_not_wanted_is_not_made() {
        let mut all = given(Wanted::ALL);
        all.sort_unstable();
        assert_eq!(all, Topic::ALL);
        for topic in Topic::ALL {
            assert_eq!(given(Wanted::of(|of| of == topic)), [topic]);
        }
        assert_eq!(given(Wanted::NONE), []);
        assert!(!Wanted::of(|topic| topic == Topic::Picture).needs_steps());
    }

    #[test]
    fn a_frame_that_claims_more_pixels_than_it_has_gives_no_picture() {
        let memory = claiming([960, 720]);
        let whole = picture(&memory).map(|(width, height, rgb)| (width, height, rgb.len()));
        assert_eq!(whole, Some((960, 720, 960 * 720 * 3)));
        for sides in [[960, 721], [u32::MAX, 720], [720, u32::MAX], [u32::MAX; 2]] {
            assert_eq!(picture(&claiming(sides)), None, "{sides:?}");
        }
        assert_eq!(picture(&memory[..100]), None);
    }
}
