//! The shared memory that a run needs, computed from its configuration.
//!
//! The files of a run are sparse: they occupy only the places of messages that were sent at
//! least once, and keep them. What a run can occupy at most:
//!
//! | part | when |
//! |---|---|
//! | the queue of steps | it is full while the supervisor does not read |
//! | offers of weights, each as long as the longest policy | until they are adopted |
//! | two frames | with a judge that is asked with pictures |
//! | all other messages | always |
//!
//! The computed need is that of full queues, which a short run does not reach: a run of the
//! default configuration asks for 44 MB.

use std::fmt;

use shm_config::config::{Config, Keep};
use shm_config::message::{Frame, Step, Timing, Weights};
use shm_config::services::STEP_QUEUE;
use shm_config::wire::PUBLISHERS_MAX;

use crate::cli::failure::Failure;
use crate::set::table::rows;

/// The folder of shared memory.
pub const SHARED_MEMORY_DIR: &str = "/dev/shm";

/// Steps outside a full queue: one at each reader and writer.
const STEPS_BESIDE: usize = 100;
/// Simultaneous offers of weights: one by `./vlaps swap`; with a learner, its newest and
/// the one that it writes.
const OFFERS_BY_HAND: usize = 1;
const OFFERS_OF_LEARNER: usize = 2;
/// Simultaneous frames: the newest, and the one that is being drawn.
const FRAMES: usize = 2;
/// All other messages, the queues' slots and the discovery files: 0.9 MB measured.
const OTHERS_BYTES: u64 = 2 << 20;
/// Full queues of a recorder: 64 of each message of the tick, 1.5 MB.
const RECORDED_BYTES: u64 = 2 << 20;
/// One part in this many is added: the memory of a dead process stays until it is swept.
const MARGIN: u64 = 4;

/// The shared memory that a run needs, by purpose.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Need {
    parts: [(&'static str, u64); 4],
}

impl Need {
    /// The need of a run with this configuration.
    pub fn of(config: &Config) -> Self {
        let offers = match config.learner.enabled {
            true => OFFERS_BY_HAND + OFFERS_OF_LEARNER,
            false => OFFERS_BY_HAND,
        };
        let frames = match config.gate.asks_world() {
            true => FRAMES,
            false => 0,
        };
        let recorded = match config.keeps() {
            Keep::Nothing => 0,
            _ => RECORDED_BYTES,
        };
        let timings = rows(config).count() * PUBLISHERS_MAX * size_of::<Timing>();
        let sum = |count: usize, size: usize| (count * size) as u64;
        Self {
            parts: [
                ("steps", sum(STEP_QUEUE + STEPS_BESIDE, size_of::<Step>())),
                ("weights", sum(offers, size_of::<Weights>())),
                ("pictures", sum(frames, size_of::<Frame>())),
                ("other messages", OTHERS_BYTES + recorded + timings as u64),
            ],
        }
    }

    /// The sum with the margin, bytes.
    pub fn bytes(&self) -> u64 {
        let sum: u64 = self.parts.iter().map(|(_, bytes)| bytes).sum();
        sum + sum / MARGIN
    }
}

/// In whole megabytes of 2^20 bytes, as free memory is printed.
impl fmt::Display for Need {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let megabytes = |bytes: u64| bytes.div_ceil(1 << 20);
        let parts = self.parts.iter().filter(|(_, bytes)| *bytes > 0);
        let parts: Vec<_> = parts
            .map(|(what, bytes)| format!("{what} {}", megabytes(*bytes)))
            .collect();
        let all = megabytes(self.bytes());
        write!(f, "{all} MB ({}, and a quarter on top)", parts.join(", "))
    }
}

/// Free and total bytes of shared memory.
///
/// # Errors
/// When there is no shared memory.
pub fn shared_memory() -> Result<(u64, u64), Failure> {
    let space = rustix::fs::statvfs(SHARED_MEMORY_DIR).map_err(|error| {
        Failure::Usage(format!(
            "{SHARED_MEMORY_DIR}: {error}; processes exchange their messages in it: \
             `sudo mount -t tmpfs -o size=1g tmpfs {SHARED_MEMORY_DIR}`"
        ))
    })?;
    Ok((
        space.f_bavail * space.f_frsize,
        space.f_blocks * space.f_frsize,
    ))
}

/// Checks that a run fits into shared memory. Without this check messages would be lost when
/// memory runs out, and a process that connects to another might die of SIGBUS.
///
/// # Errors
/// When there is too little: both figures, the purposes, and what to do.
pub fn check_shared_memory(free_bytes: u64, need: &Need) -> Result<(), Failure> {
    if free_bytes >= need.bytes() {
        return Ok(());
    }
    Err(Failure::Usage(format!(
        "{SHARED_MEMORY_DIR}: {} MB free, the run needs {need}; free some with `./vlaps clean`, \
         make it larger with `sudo mount -o remount,size=1g {SHARED_MEMORY_DIR}`, or give a \
         container more with `--shm-size=1g`",
        free_bytes >> 20,
    )))
}

#[cfg(test)]
mod tests {
    use shm_config::config::GateMode;

    use super::*;

    /// The default of a container.
    const CONTAINER_BYTES: u64 = 64 << 20;

    #[test]
    fn the_need_follows_from_the_configuration_and_a_container_has_it() {
        let plain = Need::of(&Config::default());
        let mut config = Config::default();
        config.gate.mode = GateMode::Vlm;
        let shown = Need::of(&config);
        config.learner.enabled = true;
        let learning = Need::of(&config);
        let bytes = [&plain, &shown, &learning].map(Need::bytes);
        assert!(bytes.is_sorted_by(|less, more| less < more), "{bytes:?}");
        // A full step queue, an offer as measured, and all the rest.
        assert!(bytes[0] > 24_000_000 + 8_400_000, "{plain}");
        assert!(bytes[0] < CONTAINER_BYTES, "{plain}");
        let text = plain.to_string();
        assert!(text.starts_with("45 MB (steps 25, "), "{text}");
        assert!(!text.contains("pictures"), "{text}");
        assert!(shown.to_string().contains("pictures 4"), "{shown}");
    }
}
