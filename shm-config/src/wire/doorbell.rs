//! The doorbell of a process, which wakes it.

use std::time::Duration;

use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::*;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::time::Timespec;

use super::Ipc;

/// Wakes a process when one of its services has a new message.
pub struct Doorbell {
    listener: Listener<Ipc>,
}

impl Doorbell {
    /// A doorbell on an open listener.
    pub(super) fn new(listener: Listener<Ipc>) -> Self {
        Self { listener }
    }

    /// Sleeps until the bell rings or `timeout` has passed; returns immediately when
    /// it rang since the last wait. May return early.
    pub fn wait(&self, timeout: Duration) {
        let timeout = Timespec {
            tv_sec: timeout.as_secs() as i64,
            tv_nsec: i64::from(timeout.subsec_nanos()),
        };
        // poll(2) has the high-resolution timer that the listener's own timed
        // wait lacks: that one sets a socket option counted in jiffies.
        // SAFETY: the descriptor is open for as long as the listener lives.
        #[allow(unsafe_code)]
        let descriptor = unsafe {
            std::os::fd::BorrowedFd::borrow_raw(self.listener.file_descriptor().native_handle())
        };
        let _ = poll(
            &mut [PollFd::from_borrowed_fd(descriptor, PollFlags::IN)],
            Some(&timeout),
        );
        let _ = self.listener.try_wait(|_| {});
    }
}
