use std::fmt;

/// Why weights are not used. The publisher reads it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The file has no byte.
    #[error("the file is empty")]
    Empty,
    /// More bytes than a message carries.
    #[error("{bytes} bytes are over the limit of {limit}")]
    TooLarge {
        /// How many.
        bytes: u64,
        /// How many may be.
        limit: u64,
    },
    /// The bytes are not those that were sent.
    #[error("wrong hash: the offer says SHA-256 {claimed}, its bytes have {actual}")]
    WrongHash {
        /// First 8 bytes, in hex.
        claimed: String,
        /// First 8 bytes, in hex.
        actual: String,
    },
    /// The net is not the one that the file was written with.
    #[error(
        "the graph has changed since it was written: SHA-256 {actual}..., the metadata say \
         {claimed}...; if the change is intended, remove the keys vlaps.*"
    )]
    ChangedGraph {
        /// The begin of it, in hex.
        claimed: String,
        /// The begin of it, in hex.
        actual: String,
    },
    /// The file is not an ONNX model.
    #[error("not an ONNX file: {0}")]
    NotOnnx(&'static str),
    /// The file begins as an ONNX model and is cut off.
    #[error("truncated: the file ends within {0}")]
    Truncated(&'static str),
    /// More messages, nodes or values than a policy needs.
    #[error("{what}: {count} are over the limit of {limit}")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many.
        count: usize,
        /// How many may be.
        limit: usize,
    },
    /// The metadata have another format or cannot be read.
    #[error("metadata {key}: {what}")]
    Metadata {
        /// The key.
        key: String,
        /// What is wrong.
        what: String,
    },
    /// The net was trained for other features.
    #[error(
        "wrong observation layout: trained for {theirs}, this build has {ours}; train again, \
         or use the build that it was trained with"
    )]
    WrongLayout {
        /// The file's.
        theirs: String,
        /// This build's.
        ours: String,
    },
    /// The net does not take the features or does not answer with two numbers.
    #[error("wrong shape: {what} has {found}, expected {expected}")]
    WrongShape {
        /// Of what.
        what: String,
        /// What it has.
        found: String,
        /// What it must have.
        expected: String,
    },
    /// An operator outside the closed list.
    #[error("unknown operator {0}: it is not on the list of operators that a policy may use")]
    UnknownOperator(String),
    /// Weights that are not numbers.
    #[error("{0} is not finite")]
    NotFinite(String),
    /// The graph cannot be understood.
    #[error("graph: {0}")]
    Graph(String),
    /// The net's answer to a probe differs from the file's.
    #[error(
        "probe {probe} answers {answered:?}, the file says {expected:?}: off by {}, more than {tolerance}",
        Off(*answered, *expected)
    )]
    ProbeMismatch {
        /// Which, from 0.
        probe: usize,
        /// What this runtime answers.
        answered: [f32; 2],
        /// What the file says.
        expected: [f32; 2],
        /// The largest accepted difference.
        tolerance: f32,
    },
    /// An answer takes too long for a tick.
    #[error(
        "too slow: half of the answers in the warm-up took {median_us:.0} us or more, \
         policy.inference_max_us is {limit_us:.0}"
    )]
    TooSlow {
        /// Median of the warm-up, us.
        median_us: f64,
        /// The limit, us.
        limit_us: f64,
    },
    /// The file is valid, but the car has another scanner than the feature map's.
    #[error(
        "the features of a policy are those of 240 beams over 360 degrees from the car's centre; \
         the scanner of this run has {beams} over {field_of_view_deg} degrees or is mounted \
         elsewhere"
    )]
    Scanner {
        /// Beams of the run's scanner.
        beams: u32,
        /// Its field of view, degrees.
        field_of_view_deg: f64,
    },
    /// The file is valid, but no back end of this machine can run it.
    #[error("{0}")]
    NoBackEnd(String),
}

struct Off([f32; 2], [f32; 2]);

impl fmt::Display for Off {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let off = (self.0[0] - self.1[0])
            .abs()
            .max((self.0[1] - self.1[1]).abs());
        write!(f, "{off:.2e}")
    }
}
