//! The command line of `bench ipc`.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

/// Measure how long a message takes from process to process, beside bare iceoryx2
#[derive(Debug, Args)]
#[command(
    after_help = "The method is that of iceoryx2's own benchmark: two participants on two cores send \
        a message back and forth, and half of a round trip is the time of one way. Here they are two \
        processes, each round trip is measured by itself, and messages are those of the stack. The \
        first compared is our port: numbered, written, received as the newest, admitted at the door. \
        Beside it bare iceoryx2, which writes and copies out the same bytes and does nothing else, in \
        alternating blocks, so that other work of the machine meets both; and bare iceoryx2 with 8 \
        bytes, which is its own benchmark: no payload is touched there.\n\n\
        The receiver spins (as in that benchmark), sleeps until the doorbell rings (bell), or looks \
        on an absolute grid of 0.1 ms (grid). Messages go flat out (rate 0) or at a rate.\n\n\
        --dds builds bench/cyclone with Cyclone DDS where it is installed (Debian's cyclonedds-dev) \
        and measures the same sizes over its loopback; --zenoh builds bench/zenoh from the package \
        registry, some minutes the first time, and does the same.\n\n\
        Ctrl-C ends it with the rows that are done.\n\n\
        Examples:\n  \
        ./vlaps bench ipc\n  \
        ./vlaps bench ipc --dds --zenoh --json ipc.json\n  \
        ./vlaps bench ipc --message step --rate 0 --wake spin --seconds 10"
)]
pub struct BenchIpc {
    /// Which messages, one or more.
    #[arg(
        long,
        value_name = "WHICH",
        value_delimiter = ',',
        default_value = "observation,plan,command,step,advice"
    )]
    pub message: Vec<MessageChoice>,
    /// Messages a second, one or more; 0 for as fast as they are answered.
    #[arg(
        long,
        value_name = "HZ",
        value_delimiter = ',',
        default_value = "0,10,100,1000",
        value_parser = rate
    )]
    pub rate: Vec<u32>,
    /// What the receiver does meanwhile, one or more.
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
    /// Compare with Cyclone DDS, too.
    #[arg(long)]
    pub dds: bool,
    /// Compare with Zenoh, too.
    #[arg(long)]
    pub zenoh: bool,
    /// Write the rows to this file, too.
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// The other end of `bench ipc`.
#[derive(Debug, Args)]
pub struct IpcEcho {
    /// Name of the run.
    pub run: shm_config::run::RunName,
    /// The core to stay on.
    pub core: Option<usize>,
}

/// Messages that are measured.
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

/// What a receiver does until a message comes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Wake {
    /// It looks again at once.
    Spin,
    /// It sleeps until its doorbell rings.
    Bell,
    /// It sleeps until the next instant of a grid of 0.1 ms.
    Grid,
}

impl Wake {
    /// In one word.
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
