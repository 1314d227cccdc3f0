//! The settings of both programs: a TOML file that the environment variable `VLAPS_ROS`
//! names. Without it, the defaults below.

use std::path::Path;

use serde::Deserialize;
use shm_config::file::read_text;
use vehicle::Vehicle;

/// The variable with the path of the file.
pub const VARIABLE: &str = "VLAPS_ROS";
/// Longest file, bytes: a hundred times one with every key.
const BYTES_MAX: u64 = 64 << 10;
/// Longest topic name, characters.
const NAME_MAX: usize = 200;
/// Largest domain: the largest that DDS has ports for.
const DOMAIN_MAX: usize = 232;

/// The whole file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Settings {
    /// The Zenoh router, as `tcp/HOST:PORT`. The programs connect to it and to nothing else:
    /// they listen on no port and search for nothing on the network.
    pub router: String,
    /// The domain, as `ROS_DOMAIN_ID`.
    pub domain: usize,
    /// Before the names of the topics that the bridge publishes.
    pub prefix: String,
    /// The frame in which the car moves.
    pub world_frame: String,
    /// The frame of the car.
    pub base_frame: String,
    /// Whether the bridge publishes where the car is on `/tf`; not for a robot that does.
    pub publish_tf: bool,
    /// The robot that `vlaps-ros-world` drives.
    pub robot: Robot,
}

/// Which topics a robot has, and how they are read.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Robot {
    /// `sensor_msgs/LaserScan`.
    pub scan: String,
    /// `nav_msgs/Odometry`.
    pub odometry: String,
    /// `nav_msgs/Path` that the robot is to follow; empty for a robot that follows the
    /// corridor which its scanner sees.
    pub path: String,
    /// `ackermann_msgs/AckermannDriveStamped` that the robot obeys.
    pub drive: String,
    /// A scan or odometry older than this is not used, and the car brakes, ms.
    pub age_ms: f64,
    /// What says when a message was taken.
    pub stamps: Stamps,
    /// Where the base frame is, m forward of the car's centre; the rear axle is negative.
    pub base_x_m: f64,
    /// Half of the width of the road along the path, m; of a corridor, half of the width
    /// that the car needs. 0 for the width of the car.
    pub half_width_m: f64,
    /// Whether the path goes round and round.
    pub closed_path: bool,
}

impl Robot {
    /// Half of the width of the road, m, for this car.
    pub fn half_width_m(&self, vehicle: &Vehicle) -> f64 {
        match self.half_width_m {
            0.0 => vehicle.width_m,
            half_width_m => half_width_m,
        }
    }
}

/// What says when a message was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stamps {
    /// Its stamp, by the wall clock.
    Wall,
    /// Its arrival: for a simulator whose stamps are not wall time. A message that was late
    /// is then taken for a new one.
    Arrival,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            router: "tcp/127.0.0.1:7447".into(),
            domain: 0,
            prefix: "/vlaps".into(),
            world_frame: recorder::standard::WORLD_FRAME.into(),
            base_frame: recorder::standard::BODY_FRAME.into(),
            publish_tf: true,
            robot: Robot::default(),
        }
    }
}

impl Default for Robot {
    fn default() -> Self {
        Self {
            scan: "/scan".into(),
            odometry: "/odom".into(),
            path: "/plan".into(),
            drive: "/drive".into(),
            age_ms: 200.0,
            stamps: Stamps::Wall,
            base_x_m: 0.0,
            half_width_m: 0.0,
            closed_path: false,
        }
    }
}

impl Settings {
    /// Those of the file that [`VARIABLE`] names, or the defaults.
    ///
    /// # Errors
    /// One line: the file cannot be read, or a key of it is wrong.
    pub fn load() -> Result<Self, String> {
        match std::env::var_os(VARIABLE) {
            Some(path) => Self::read(Path::new(&path)),
            None => Ok(Self::default()),
        }
    }

    /// Those of a file.
    ///
    /// # Errors
    /// As [`Settings::load`].
    pub fn read(path: &Path) -> Result<Self, String> {
        let failed = |what: String| format!("{VARIABLE}={}: {what}", path.display());
        let text = read_text(path, BYTES_MAX).map_err(|error| failed(error.to_string()))?;
        let settings: Self = toml::from_str(&text).map_err(|error| {
            let line = text[..error.span().map_or(0, |span| span.start)]
                .matches('\n')
                .count();
            failed(format!("line {}: {}", line + 1, error.message()))
        })?;
        settings.check().map_err(failed)?;
        Ok(settings)
    }

    fn check(&self) -> Result<(), String> {
        let Robot {
            scan,
            odometry,
            path,
            drive,
            ..
        } = &self.robot;
        let topics = [
            ("prefix", &self.prefix),
            ("robot.scan", scan),
            ("robot.odometry", odometry),
            ("robot.drive", drive),
            ("robot.path", path),
        ];
        for (key, name) in topics {
            let may_be_empty = ["robot.path", "prefix"].contains(&key);
            if !(may_be_empty && name.is_empty() || is_topic(name)) {
                return Err(format!(
                    "{key} is not the name of a topic, such as \"/robot/scan\": letters, digits \
                     and '_' behind each '/', and no digit first"
                ));
            }
        }
        if self.domain > DOMAIN_MAX {
            return Err(format!("domain is not within 0 to {DOMAIN_MAX}"));
        }
        let numbers = [
            ("robot.age_ms", self.robot.age_ms, 1.0..=10_000.0),
            ("robot.base_x_m", self.robot.base_x_m, -30.0..=30.0),
            ("robot.half_width_m", self.robot.half_width_m, 0.0..=100.0),
        ];
        for (key, value, range) in numbers {
            if !range.contains(&value) {
                let (least, most) = (range.start(), range.end());
                return Err(format!("{key} is not within {least} to {most}"));
            }
        }
        Ok(())
    }
}

/// Whether a name is an absolute one of a ROS topic.
fn is_topic(name: &str) -> bool {
    let is_word = |word: &str| {
        let starts = word
            .bytes()
            .next()
            .is_some_and(|byte| !byte.is_ascii_digit());
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'_';
        starts && word.bytes().all(plain)
    };
    let words = name.strip_prefix('/').map(|rest| rest.split('/'));
    name.len() <= NAME_MAX && words.is_some_and(|mut words| words.all(is_word))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Settings, String> {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("ros.toml");
        std::fs::write(&path, text).expect("a file");
        Settings::read(&path)
    }

    #[test]
    fn a_file_gives_what_differs() {
        let settings =
            read("domain = 7\n[robot]\nscan = \"/lidar/scan_1\"\nstamps = \"arrival\"\n");
        let settings = settings.expect("settings");
        assert_eq!(settings.domain, 7);
        assert_eq!(settings.robot.scan, "/lidar/scan_1");
        assert_eq!(settings.robot.stamps, Stamps::Arrival);
        assert_eq!(settings.robot.odometry, "/odom");
        assert_eq!(Settings::default().check(), Ok(()));
        assert!(read("[robot]\npath = \"\"\n").is_ok());
    }

    #[test]
    fn what_is_wrong_is_named_in_one_line() {
        for (text, named) in [
            ("domain = 233", "domain"),
            ("domain = -1", "line 1"),
            ("\nsomething = 1", "something"),
            ("[robot]\nscan = \"scan\"", "robot.scan"),
            ("[robot]\nscan = \"\"", "robot.scan"),
            ("[robot]\nscan = \"/a//b\"", "robot.scan"),
            ("[robot]\nscan = \"/a/*\"", "robot.scan"),
            ("[robot]\nscan = \"/1a\"", "robot.scan"),
            ("[robot]\nage_ms = nan", "robot.age_ms"),
            ("[robot]\nage_ms = 0", "robot.age_ms"),
            ("[robot]\nhalf_width_m = inf", "robot.half_width_m"),
            ("[robot]\nstamps = \"sim\"", "sim"),
        ] {
            let error = read(text).expect_err(text);
            assert!(
                error.contains(named) && error.contains("ros.toml"),
                "{error}"
            );
            assert_eq!(error.lines().count(), 1, "{error}");
        }
    }
}
