//! The figures of an evaluation: one key and one name for each, used in all tables,
//! files and plots.

/// A figure of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// Arrived, with or without contacts: the paper's metric.
    Success,
    /// Arrived without a contact with a vehicle or an object.
    StrictSuccess,
    /// The simulator's crash flag at the last step: the paper's metric.
    CrashLastStep,
    /// Contact with a vehicle or an object at any step.
    Contact,
    /// Left the road.
    OutOfRoad,
    /// Reached the maximum number of steps.
    MaxStep,
    /// Share of the route driven.
    Completion,
    /// Number of steps of an episode.
    MeanLength,
    /// Driven length over time.
    MeanSpeed,
}

/// Note below tables that contain both figures of contacts.
pub const FOOTNOTE: &str = "crash at the last step is MetaDrive's flag, which counts sidewalks, \
    too; contact counts vehicles and objects, at any step: either may be the larger one.";

impl Metric {
    /// All figures, in the order of the tables.
    pub const ALL: [Metric; 9] = [
        Metric::Success,
        Metric::StrictSuccess,
        Metric::CrashLastStep,
        Metric::Contact,
        Metric::OutOfRoad,
        Metric::MaxStep,
        Metric::Completion,
        Metric::MeanLength,
        Metric::MeanSpeed,
    ];

    /// The key in CSV and JSON.
    pub fn key(self) -> &'static str {
        match self {
            Metric::Success => "success",
            Metric::StrictSuccess => "strict_success",
            Metric::CrashLastStep => "crash_last_step",
            Metric::Contact => "contact",
            Metric::OutOfRoad => "out_of_road",
            Metric::MaxStep => "max_step",
            Metric::Completion => "completion",
            Metric::MeanLength => "mean_length",
            Metric::MeanSpeed => "mean_speed_mps",
        }
    }

    /// The name in tables and plots, with the unit.
    pub fn name(self) -> &'static str {
        match self {
            Metric::Success => "success",
            Metric::StrictSuccess => "strict success",
            Metric::CrashLastStep => "crash at the last step",
            Metric::Contact => "contact",
            Metric::OutOfRoad => "out of road",
            Metric::MaxStep => "max step",
            Metric::Completion => "completion",
            Metric::MeanLength => "length, steps",
            Metric::MeanSpeed => "speed, m/s",
        }
    }

    /// Upper limit of the figure: 1 for shares, infinity otherwise.
    pub fn most(self) -> f64 {
        match self {
            Metric::MeanLength | Metric::MeanSpeed => f64::INFINITY,
            _ => 1.0,
        }
    }

    /// Number of significant digits after the point.
    pub fn digits(self) -> usize {
        match self {
            Metric::MeanLength => 0,
            Metric::MeanSpeed => 2,
            _ => 3,
        }
    }
}
