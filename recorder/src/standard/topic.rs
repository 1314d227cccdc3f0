use super::definitions::definition;
use crate::Channel;

/// One standard topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Where the car is, as a transform.
    Transform,
    /// Where the car is.
    Pose,
    /// The plan in force.
    Plan,
    /// The lidar.
    Scan,
    /// Road, car, bodies that move, rollouts.
    Scene,
    /// The search tree of the plan.
    Tree,
    /// The picture that a judge was asked about.
    Picture,
    /// How drive and processes are doing.
    Diagnostics,
}

impl Topic {
    /// All, in the order in which they are written.
    pub const ALL: [Self; 8] = [
        Self::Transform,
        Self::Pose,
        Self::Plan,
        Self::Scan,
        Self::Scene,
        Self::Tree,
        Self::Picture,
        Self::Diagnostics,
    ];

    /// The topic's name, without the `/` before it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Transform => "tf",
            Self::Pose => "ros/pose",
            Self::Plan => "ros/plan",
            Self::Scan => "ros/scan",
            Self::Scene => "ros/scene",
            Self::Tree => "ros/tree",
            Self::Picture => "ros/picture",
            Self::Diagnostics => "diagnostics",
        }
    }

    /// Package and name of its type.
    fn type_name(self) -> (&'static str, &'static str) {
        match self {
            Self::Transform => ("tf2_msgs", "TFMessage"),
            Self::Pose => ("geometry_msgs", "PoseStamped"),
            Self::Plan => ("nav_msgs", "Path"),
            Self::Scan => ("sensor_msgs", "LaserScan"),
            Self::Scene | Self::Tree => ("visualization_msgs", "MarkerArray"),
            Self::Picture => ("sensor_msgs", "CompressedImage"),
            Self::Diagnostics => ("diagnostic_msgs", "DiagnosticArray"),
        }
    }

    /// Its place in a set.
    fn bit(self) -> u8 {
        1 << self as u8
    }

    /// Its channel.
    pub fn channel(self) -> Channel {
        let (package, name) = self.type_name();
        Channel {
            service: self.name().into(),
            schema: format!("{package}/msg/{name}"),
            definition: definition(&format!("{package}/{name}")),
            layout: String::new(),
        }
    }
}

/// A set of standard topics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wanted(u8);

impl Wanted {
    /// All of them.
    pub const ALL: Self = Self(u8::MAX);
    /// None.
    pub const NONE: Self = Self(0);

    /// Those for which a predicate holds.
    pub fn of(mut wants: impl FnMut(Topic) -> bool) -> Self {
        let wanted = Topic::ALL.into_iter().filter(|topic| wants(*topic));
        Self(wanted.fold(0, |set, topic| set | topic.bit()))
    }

    /// Whether a topic is one of them.
    pub fn has(self, topic: Topic) -> bool {
        self.0 & topic.bit() != 0
    }

    /// Whether one of them is made from a step.
    pub fn needs_steps(self) -> bool {
        self.0 & !Topic::Picture.bit() != 0
    }
}

// Each topic has a bit.
const _: () = assert!(Topic::ALL.len() <= u8::BITS as usize);
