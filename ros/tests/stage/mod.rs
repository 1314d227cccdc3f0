//! A router and the other side of the topics, for the tests.
#![allow(dead_code)] // each test uses a part

use std::net::TcpListener;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use recorder::schema::ENCAPSULATION;
use vlaps_ros::names::TopicType;
use vlaps_ros::settings::Settings;
use vlaps_ros::wall::Moment;
use zenoh::sample::Sample;
use zenoh::{Config, Session, Wait};

/// A message that does not come within this time never does.
pub const LOST: Duration = Duration::from_secs(30);

/// A port of this machine that is free.
pub fn free_router() -> String {
    let free = TcpListener::bind("127.0.0.1:0").expect("a port");
    format!("tcp/{}", free.local_addr().expect("its address"))
}

/// A Zenoh router at this address, as rmw_zenoh's; `None` while the port is not free yet.
pub fn try_router(address: &str) -> Option<Session> {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", "\"router\"".to_string()),
        ("listen/endpoints", format!("[{address:?}]")),
        ("scouting/multicast/enabled", "false".into()),
    ] {
        config.insert_json5(key, &value).expect(key);
    }
    zenoh::open(config).wait().ok()
}

/// The same, at once.
pub fn router(address: &str) -> Session {
    try_router(address).expect("a router")
}

/// Settings with this router.
pub fn settings(address: &str) -> Settings {
    Settings {
        router: address.into(),
        ..Settings::default()
    }
}

/// The tokens of nodes and of ends of topics that a router knows.
pub fn tokens(router: &Session) -> Vec<String> {
    let tokens = router.liveliness().get("@ros2_lv/0/**").wait();
    let tokens = tokens.expect("tokens");
    std::iter::from_fn(|| tokens.recv().ok())
        .filter_map(|reply| Some(reply.result().ok()?.key_expr().to_string()))
        .collect()
}

/// What arrives on a key.
pub fn hear(session: &Session, key: &str) -> Receiver<Sample> {
    let (into, out) = channel();
    session
        .declare_subscriber(key.to_string())
        .callback(move |sample| drop(into.send(sample)))
        .background()
        .wait()
        .expect("a subscription");
    out
}

/// Publishes as rmw_zenoh does, under any type.
pub fn put(session: &Session, topic: &str, of: &TopicType, cdr: &[u8]) {
    let topic = topic.trim_start_matches('/');
    let key = format!("0/{topic}/{}/{}", of.dds_name(), of.hash);
    session.put(key, cdr).wait().expect("it is sent");
}

/// Waits until something holds, without a limit of its own but [`LOST`].
pub fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let begun = Moment::now().now;
    while !holds() {
        let waited_ns = Moment::now().now.since_ns(begun);
        assert!(u128::from(waited_ns) < LOST.as_nanos(), "never: {what}");
        std::thread::park_timeout(Duration::from_millis(10));
    }
}

/// CDR, written by hand.
#[derive(Debug, Clone)]
pub struct Write(pub Vec<u8>);

impl Default for Write {
    fn default() -> Self {
        Self(ENCAPSULATION.to_vec())
    }
}

impl Write {
    pub fn bytes<const N: usize>(mut self, bytes: [u8; N]) -> Self {
        while !(self.0.len() - 4).is_multiple_of(N) {
            self.0.push(0);
        }
        self.0.extend(bytes);
        self
    }

    pub fn u32(self, value: u32) -> Self {
        self.bytes(value.to_le_bytes())
    }

    pub fn f32s(self, values: &[f32]) -> Self {
        values
            .iter()
            .fold(self, |to, value| to.bytes(value.to_le_bytes()))
    }

    pub fn f64s(self, values: &[f64]) -> Self {
        values
            .iter()
            .fold(self, |to, value| to.bytes(value.to_le_bytes()))
    }

    pub fn text(self, text: &str) -> Self {
        let mut to = self.u32(text.len() as u32 + 1);
        to.0.extend(text.as_bytes());
        to.0.push(0);
        to
    }

    pub fn header(self, epoch_ns: u64, frame: &str) -> Self {
        let (s, ns) = (epoch_ns / 1_000_000_000, epoch_ns % 1_000_000_000);
        self.u32(s as u32).u32(ns as u32).text(frame)
    }

    pub fn pose(self, x_m: f64, y_m: f64, heading_rad: f64) -> Self {
        let (sin, cos) = (heading_rad / 2.0).sin_cos();
        self.f64s(&[x_m, y_m, 0.0, 0.0, 0.0, sin, cos])
    }
}

/// A scan over the full circle, one range each degree.
pub fn scan(epoch_ns: u64, frame: &str, range_m: f32) -> Vec<u8> {
    scan_of(epoch_ns, frame, &[range_m; 360])
}

/// A scan over the full circle with these ranges, m.
pub fn scan_of(epoch_ns: u64, frame: &str, ranges_m: &[f32]) -> Vec<u8> {
    let turn = std::f32::consts::TAU / ranges_m.len() as f32;
    let half = turn * (ranges_m.len() / 2) as f32;
    let to = Write::default().header(epoch_ns, frame);
    let to = to.f32s(&[-half, half - turn, turn, 0.0, 0.0, 0.05, 30.0]);
    to.u32(ranges_m.len() as u32).f32s(ranges_m).u32(0).0
}

/// Odometry at a place.
pub fn odometry(epoch_ns: u64, pose: [f64; 3], speed_mps: f64) -> Vec<u8> {
    odometry_in("odom", epoch_ns, pose, speed_mps)
}

/// Odometry at a place of a frame.
pub fn odometry_in(
    frame: &str,
    epoch_ns: u64,
    [x_m, y_m, heading_rad]: [f64; 3],
    speed_mps: f64,
) -> Vec<u8> {
    let to = Write::default().header(epoch_ns, frame).text("base_link");
    let to = to.pose(x_m, y_m, heading_rad).f64s(&[f64::NAN; 36]);
    to.f64s(&[speed_mps, 0.0, 0.0, 0.0, 0.0, 0.25])
        .f64s(&[0.0; 36])
        .0
}

/// One transform.
pub fn transform(parent: &str, child: &str, [x_m, y_m, heading_rad]: [f64; 3]) -> Vec<u8> {
    let to = Write::default().u32(1).header(0, parent).text(child);
    to.pose(x_m, y_m, heading_rad).0
}

/// A path through these places.
pub fn path(frame: &str, places: &[[f64; 2]]) -> Vec<u8> {
    let to = Write::default().header(0, frame).u32(places.len() as u32);
    let poses = places.iter();
    poses
        .fold(to, |to, [x_m, y_m]| {
            to.header(0, frame).pose(*x_m, *y_m, 0.0)
        })
        .0
}

/// A standard type.
pub fn standard(short: &str) -> TopicType {
    TopicType::standard(short).expect("a type")
}

/// The Python with rosbags, mcap-ros2-support and cyclonedds; `None`, told, without it.
pub fn python(test: &str) -> Option<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("..");
    let home = std::env::var_os("VLAPS_ROS_PYTHON");
    let home = home.map_or_else(|| root.join("target/ros-python"), PathBuf::from);
    let python = home.join("bin/python");
    if python.is_file() {
        return Some(python);
    }
    println!(
        "skipped: {test}: no {}; docs/ros.md says how it is made",
        python.display()
    );
    None
}
