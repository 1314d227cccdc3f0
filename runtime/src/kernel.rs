//! System calls that no library wraps: the unsafe part of this crate.

use shm_config::message::Scheduling;

/// What the kernel counted for one thread since it began.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Usage {
    /// Page faults that needed no disk.
    pub minor_faults: u64,
    /// Page faults that waited for the disk.
    pub major_faults: u64,
    /// Times that the processor was taken away from it.
    pub involuntary_switches: u64,
}

impl Usage {
    /// Of the calling thread: getrusage(2) with `RUSAGE_THREAD`, no allocation, no
    /// wait, a third of a microsecond.
    #[allow(unsafe_code)]
    pub fn of_this_thread() -> Self {
        // SAFETY: `rusage` is made of numbers, so all zeros are one, and the kernel
        // writes nothing but it.
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

    /// What was added since an earlier look.
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
#[allow(unsafe_code)]
pub fn set_fifo(priority: u32) -> bool {
    let parameters = libc::sched_param {
        sched_priority: priority as libc::c_int,
    };
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: pid 0 is the calling thread and the parameters live through the call.
    unsafe { libc::sched_setscheduler(0, policy, &parameters) == 0 }
}

/// Ordinary scheduling for the calling thread.
#[allow(unsafe_code)]
pub fn set_ordinary() -> bool {
    let parameters = libc::sched_param { sched_priority: 0 };
    // Only the privileged may take the flag away again.
    let policy = libc::SCHED_OTHER | libc::SCHED_RESET_ON_FORK;
    // SAFETY: pid 0 is the calling thread and the parameters live through the call.
    unsafe { libc::sched_setscheduler(0, policy, &parameters) == 0 }
}

/// How the calling thread is scheduled, and its real-time priority (0 for none),
/// as the kernel says.
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

/// The heap keeps what is freed: given back to the kernel, it would fault anew.
#[allow(unsafe_code)]
pub fn keep_heap() {
    #[cfg(target_env = "gnu")]
    // SAFETY: mallopt changes two thresholds of the allocator, under its own lock.
    unsafe {
        libc::mallopt(libc::M_TRIM_THRESHOLD, libc::c_int::MAX);
        // The most that glibc takes.
        libc::mallopt(libc::M_MMAP_THRESHOLD, 32 << 20);
    }
}
