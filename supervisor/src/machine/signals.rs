//! Signals as bytes in sockets, so that the loop can sleep until one comes.

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

/// The signals that concern the supervisor.
#[derive(Debug)]
pub struct Signals {
    stop: UnixStream,
    stop_sender: UnixStream,
    child: UnixStream,
    late: LateSignals,
}

/// What a signal does that comes after the process set has ended.
#[derive(Debug, Clone, Default)]
pub struct LateSignals {
    /// It ends this process at once.
    ends: Arc<AtomicBool>,
    /// The number of the signal that came last.
    last: Arc<AtomicUsize>,
}

impl LateSignals {
    /// From now on a signal that asks to stop ends this process, with the exit code
    /// that shells give it.
    pub fn end_at_once(&self) {
        self.ends.store(true, Ordering::SeqCst);
    }

    /// The number of the signal that came last; 0 when none has come.
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
    /// Takes over SIGINT, SIGTERM, SIGHUP and SIGCHLD. A hang-up that the caller
    /// chose to ignore, as `nohup` does, stays ignored.
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

    /// SIGQUIT (Ctrl-\) asks to stop, too: whoever has changed the terminal must
    /// live to put it back.
    ///
    /// # Errors
    /// When the system refuses.
    pub fn stop_on_quit(&self) -> io::Result<()> {
        self.late.register(SIGQUIT)?;
        pipe::register(SIGQUIT, self.stop_sender.try_clone()?)?;
        Ok(())
    }

    /// What signals do once nothing is left to stop.
    pub fn late(&self) -> LateSignals {
        self.late.clone()
    }

    /// Sleeps until a signal comes or `timeout_ns` has passed. May return early.
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

    /// How many times somebody asked to stop since the last call.
    pub fn take_stops(&mut self) -> usize {
        drain(&mut self.stop)
    }
}

/// Waits a moment for another process, outside any loop that has a period.
pub fn pause(moment: Duration) {
    let moment = Timespec {
        tv_sec: moment.as_secs() as i64,
        tv_nsec: i64::from(moment.subsec_nanos()),
    };
    // Cut short by a signal, the caller looks again a little earlier.
    let _ = poll(&mut [], Some(&moment));
}

/// One byte came for each signal.
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
