//! The figures of an evaluation: one key and one name for each in all tables,
//! files and pictures.

/// A figure of an evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// Arrived, contacts or not: the paper's.
    Success,
    /// Arrived without having touched a vehicle or an object.
    StrictSuccess,
    /// The simulator's crash flag at the last step: the paper's.
    CrashLastStep,
    /// Touched a vehicle or an object at any step.
    Contact,
    /// Left the road.
    OutOfRoad,
    /// Ran out of steps.
    MaxStep,
    /// Share of the route driven.
    Completion,
    /// Steps of an episode.
    MeanLength,
    /// Length driven by time.
    MeanSpeed,
}

/// Why one of two figures of touching may be the larger one.
pub const FOOTNOTE: &str = "crash at the last step is MetaDrive's flag, which counts sidewalks, \
    too; contact counts vehicles and objects, at any step: either may be the larger one.";

impl Metric {
    /// All of them, in the order of tables.
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

    /// In CSV and JSON.
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

    /// In tables and pictures, with the unit.
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

    /// What it cannot exceed: shares have a limit.
    pub fn most(self) -> f64 {
        match self {
            Metric::MeanLength | Metric::MeanSpeed => f64::INFINITY,
            _ => 1.0,
        }
    }

    /// Digits behind the point that mean anything.
    pub fn digits(self) -> usize {
        match self {
            Metric::MeanLength => 0,
            Metric::MeanSpeed => 2,
            _ => 3,
        }
    }
}
