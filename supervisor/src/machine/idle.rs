//! The bound on processor sleep while a set drives.
//!
//! A sleeping processor takes time to wake up, a virtual one most of all, since its host
//! must schedule it again first. A process that holds [`DEVICE`] open bounds that time for
//! the whole machine (PM QoS). The kernel drops the bound when the file is closed, so a
//! killed supervisor leaves none behind.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};

use shm_config::config::Config;
use shm_config::message::Grant;

/// The device that takes a bound as a signed 32-bit number of microseconds.
pub const DEVICE: &str = "/dev/cpu_dma_latency";

/// A bound on the time that a processor needs to wake up, while this value lives.
#[derive(Debug)]
pub struct IdleBound {
    grant: Grant,
    _device: Option<File>,
}

impl IdleBound {
    /// Asks for `supervisor.cpu_latency_us`, unless it is negative or the run asks for no
    /// real-time privileges.
    pub fn of(config: &Config) -> Self {
        let bound_us = config.supervisor.cpu_latency_us;
        let is_real_time = config.supervisor.realtime && !config.run.is_lockstep();
        match is_real_time && bound_us >= 0 {
            true => Self::ask(bound_us),
            false => Self {
                grant: Grant::Unasked,
                _device: None,
            },
        }
    }

    /// Asks for a bound, us.
    pub fn ask(bound_us: i32) -> Self {
        let device = hold(bound_us).ok();
        Self {
            grant: match device {
                Some(_) => Grant::Granted,
                None => Grant::Refused,
            },
            _device: device,
        }
    }

    /// Whether the bound was granted.
    pub fn grant(&self) -> Grant {
        self.grant
    }
}

fn hold(bound_us: i32) -> io::Result<File> {
    let mut device = OpenOptions::new().write(true).open(DEVICE)?;
    device.write_all(&bound_us.to_ne_bytes())?;
    Ok(device)
}
