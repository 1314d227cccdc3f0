//! Signals as bytes in sockets, so that the loop can sleep until one arrives.

use std::fs;
use std::io::{self, Read};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::time::Timespec;
use signal_hook::consts::{SIGCHLD, SIGHUP, SIGINT, SIGQUIT, SIGTERM};
use signal_hook::flag;
use signal_hook::low_level::pipe;

use crate::cli::failure::EXIT_SIGNAL;

/// The signals that the supervisor handles.
#[derive(Debug)]
pub struct Signals {
    stop: UnixStream,
    stop_sender: UnixStream,
    child: UnixStream,
    late: LateSignals,
}

/// The effect of a signal that arrives after the process set has ended.
#[derive(Debug, Clone, Default)]
pub struct LateSignals {
    /// Whether it ends this process immediately.
    ends: Arc<AtomicBool>,
    /// The number of the last signal.
    last: Arc<AtomicUsize>,
}

impl LateSignals {
    /// From now on a stop signal ends this process immediately, with the exit code that
    /// shells use: 128 and the signal's number.
    pub fn end_at_once(&self) {
        self.ends.store(true, Ordering::SeqCst);
    }

    /// The number of the last signal; 0 before the first.
    pub fn last(&self) -> u8 {
        u8::try_from(self.last.load(Ordering::SeqCst)).unwrap_or_default()
    }

    fn register(&self, signal: i32) -> io::Result<()> {
        let exit_code = i32::from(EXIT_SIGNAL) + signal;
        flag::register_conditional_shutdown(signal, exit_code, self.ends.clone())?;
        let number = usize::try_from(signal).unwrap_or_default();
        flag::register_usize(signal, self.last.clone(), number)?;
        Ok(())
    }
}

impl Signals {
    /// Handles SIGINT, SIGTERM, SIGHUP and SIGCHLD. A SIGHUP that the caller ignores, as
    /// `nohup` does, stays ignored.
    ///
    /// # Errors
    /// When the system refuses a socket or a handler.
    pub fn install() -> io::Result<Self> {
        let (stop, stop_sender) = UnixStream::pair()?;
        let (child, child_sender) = UnixStream::pair()?;
        stop.set_nonblocking(true)?;
        child.set_nonblocking(true)?;
        let late = LateSignals::default();
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            if signal != SIGHUP || !is_ignored(SIGHUP) {
                late.register(signal)?;
                pipe::register(signal, stop_sender.try_clone()?)?;
            }
        }
        pipe::register(SIGCHLD, child_sender)?;
        Ok(Self {
            stop,
            stop_sender,
            child,
            late,
        })
    }

    /// Handles SIGQUIT (Ctrl-\) as a stop signal too: a process that has changed the terminal
    /// mode must restore it.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn stop_on_quit(&self) -> io::Result<()> {
        self.late.register(SIGQUIT)?;
        pipe::register(SIGQUIT, self.stop_sender.try_clone()?)?;
        Ok(())
    }

    /// The effect of signals after the set has ended.
    pub fn late(&self) -> LateSignals {
        self.late.clone()
    }

    /// Sleeps until a signal arrives or `timeout_ns` has passed. May return early.
    pub fn wait(&mut self, timeout_ns: u64) {
        let timeout = Timespec {
            tv_sec: (timeout_ns / 1_000_000_000) as i64,
            tv_nsec: (timeout_ns % 1_000_000_000) as i64,
        };
        let mut sockets = [
            PollFd::new(&self.stop, PollFlags::IN),
            PollFd::new(&self.child, PollFlags::IN),
        ];
        // An interrupted wait is an early return.
        let _ = poll(&mut sockets, Some(&timeout));
        drain(&mut self.child);
    }

    /// The number of stop signals since the last call.
    pub fn take_stops(&mut self) -> usize {
        drain(&mut self.stop)
    }
}

/// Sleeps while another process works, outside any periodic loop.
pub fn pause(moment: Duration) {
    let moment = Timespec {
        tv_sec: moment.as_secs() as i64,
        tv_nsec: i64::from(moment.subsec_nanos()),
    };
    // After a signal it returns early, and the caller checks a little earlier.
    let _ = poll(&mut [], Some(&moment));
}

/// Reads the pending bytes, one for each signal.
fn drain(socket: &mut UnixStream) -> usize {
    let mut bytes = [0; 64];
    socket.read(&mut bytes).unwrap_or(0)
}

fn is_ignored(signal: i32) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    status
        .lines()
        .find_map(|line| line.strip_prefix("SigIgn:"))
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .is_some_and(|mask| mask & (1 << (signal - 1)) != 0)
}
