//! Command line of `bench ipc`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// Measure message latency between processes, and compare with bare iceoryx2
#[derive(Debug, Args)]
#[command(
    after_help = "The method is that of iceoryx2's own benchmark: two participants on two cores send \
        a message back and forth, and half of a round trip is the time of one way. Here they are two \
        processes, each round trip is timed separately, and messages are those of the stack. Four \
        sides alternate in blocks, so that other work of the machine affects all of them alike: the \
        stack's port (numbered, written, received as the newest, checked on receipt); the port \
        without that check; bare iceoryx2, which only writes and copies out the same bytes; and bare \
        iceoryx2 with 8 bytes, which is its own benchmark.\n\n\
        The receiver spins (as in that benchmark), sleeps until the doorbell rings (bell), or polls \
        on an absolute grid of 0.1 ms (grid). Rate 0 sends the next message as soon as the answer \
        arrives.\n\n\
        --dds builds bench/cyclone with Cyclone DDS where it is installed (Debian's cyclonedds-dev) \
        and measures the same sizes over its loopback; --zenoh builds bench/zenoh from the package \
        registry, which takes some minutes the first time, and measures the same.\n\n\
        Ctrl-C ends it with the rows that are done.\n\n\
        Examples:\n  \
        ./vlaps bench ipc\n  \
        ./vlaps bench ipc --dds --zenoh --json ipc.json\n  \
        ./vlaps bench ipc --message step --rate 0 --wake spin --seconds 10"
)]
pub struct BenchIpc {
    /// Messages, one or more.
    #[arg(
        long,
        value_name = "WHICH",
        value_delimiter = ',',
        default_value = "observation,plan,command,step,advice"
    )]
    pub message: Vec<MessageChoice>,
    /// Messages per second, one or more; 0 for as fast as they are answered.
    #[arg(
        long,
        value_name = "HZ",
        value_delimiter = ',',
        default_value = "0,10,100,1000",
        value_parser = rate
    )]
    pub rate: Vec<u32>,
    /// How the receiver waits, one or more.
    #[arg(
        long,
        value_name = "HOW",
        value_delimiter = ',',
        default_value = "spin,bell,grid"
    )]
    pub wake: Vec<Wake>,
    /// Seconds for each side of a row.
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = supervisor::subcommand::seconds)]
    pub seconds: f64,
    /// Also compare with Cyclone DDS.
    #[arg(long)]
    pub dds: bool,
    /// Also compare with Zenoh.
    #[arg(long)]
    pub zenoh: bool,
    /// Also write the rows to this file.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// The answering process of `bench ipc`.
#[derive(Debug, Args)]
pub struct IpcEcho {
    /// Name of the run.
    pub run: shm_config::run::RunName,
    /// Core to pin it to.
    pub core: Option<usize>,
}

/// Messages to measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum MessageChoice {
    /// World to planner and controller.
    Observation,
    /// Planner to controller.
    Plan,
    /// Controller to world.
    Command,
    /// Controller to gate, learner and recorder.
    Step,
    /// Gate to controller.
    Advice,
}

/// How a receiver waits for a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Wake {
    /// Polls without pause.
    Spin,
    /// Sleeps until its doorbell rings.
    Bell,
    /// Sleeps until the next instant of a grid of 0.1 ms.
    Grid,
}

impl Wake {
    /// The name on the command line.
    pub fn word(self) -> &'static str {
        match self {
            Self::Spin => "spin",
            Self::Bell => "bell",
            Self::Grid => "grid",
        }
    }
}

fn rate(text: &str) -> Result<u32, String> {
    let rate: u32 = text.parse().map_err(|_| "not a whole number".to_string())?;
    match rate <= 10_000 {
        true => Ok(rate),
        false => Err("must be within 0 and 10000".into()),
    }
}
