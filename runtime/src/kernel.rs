//! System calls that no library wraps: the unsafe part of this crate.

use std::io;

use shm_config::message::Scheduling;

/// What the kernel has counted for one thread since the thread began.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Usage {
    /// Page faults that needed no disk access.
    pub minor_faults: u64,
    /// Page faults that waited for the disk.
    pub major_faults: u64,
    /// Times that the kernel took the processor away from the thread.
    pub involuntary_switches: u64,
}

impl Usage {
    /// The counts of the calling thread: getrusage(2) with `RUSAGE_THREAD`. No
    /// allocation, no wait, a third of a microsecond.
    #[allow(unsafe_code)]
    pub fn of_this_thread() -> Self {
        // SAFETY: `rusage` consists of numbers, so all zeros are a valid value, and the
        // kernel writes nothing else.
        let usage = unsafe {
            let mut usage: libc::rusage = std::mem::zeroed();
            match libc::getrusage(libc::RUSAGE_THREAD, &mut usage) {
                0 => usage,
                _ => return Self::default(),
            }
        };
        Self {
            minor_faults: usage.ru_minflt as u64,
            major_faults: usage.ru_majflt as u64,
            involuntary_switches: usage.ru_nivcsw as u64,
        }
    }

    /// The counts added since an earlier reading.
    #[must_use]
    pub fn since(self, earlier: Self) -> Self {
        Self {
            minor_faults: self.minor_faults.saturating_sub(earlier.minor_faults),
            major_faults: self.major_faults.saturating_sub(earlier.major_faults),
            involuntary_switches: self
                .involuntary_switches
                .saturating_sub(earlier.involuntary_switches),
        }
    }
}

/// `SCHED_FIFO` for the calling thread. Threads started later do not inherit it.
///
/// # Errors
/// When the kernel refuses it: no privilege, or a priority outside 1 to 99.
#[allow(unsafe_code)]
pub fn set_fifo(priority: u32) -> io::Result<()> {
    let parameters = libc::sched_param {
        sched_priority: priority as libc::c_int,
    };
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: pid 0 is the calling thread and the parameters live through the call.
    match unsafe { libc::sched_setscheduler(0, policy, &parameters) } {
        0 => Ok(()),
        _ => Err(io::Error::last_os_error()),
    }
}

/// Sets ordinary scheduling for the calling thread.
#[allow(unsafe_code)]
pub fn set_ordinary() -> bool {
    let parameters = libc::sched_param { sched_priority: 0 };
    // Only a privileged thread may clear the reset-on-fork flag.
    let policy = libc::SCHED_OTHER | libc::SCHED_RESET_ON_FORK;
    // SAFETY: pid 0 is the calling thread and the parameters live through the call.
    unsafe { libc::sched_setscheduler(0, policy, &parameters) == 0 }
}

/// The scheduling of the calling thread, and its real-time priority (0 for none), as
/// the kernel reports them.
#[allow(unsafe_code)]
pub fn own_scheduling() -> (Scheduling, u32) {
    let mut parameters = libc::sched_param { sched_priority: 0 };
    // SAFETY: pid 0 is the calling thread, and the kernel writes the parameters,
    // which live through the call.
    let policy = unsafe {
        libc::sched_getparam(0, &mut parameters);
        libc::sched_getscheduler(0)
    };
    let scheduling = match policy & !libc::SCHED_RESET_ON_FORK {
        libc::SCHED_FIFO => Scheduling::Fifo,
        _ => Scheduling::Ordinary,
    };
    (scheduling, parameters.sched_priority.max(0) as u32)
}

/// Makes the heap keep freed memory: memory returned to the kernel would fault again.
#[allow(unsafe_code)]
pub fn keep_heap() {
    #[cfg(target_env = "gnu")]
    // SAFETY: mallopt changes two thresholds of the allocator, under its own lock.
    unsafe {
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
        // The largest value that glibc takes.
        libc::mallopt(libc::M_MMAP_THRESHOLD, 32 << 20);
    }
}
