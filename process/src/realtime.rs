use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity};
use shm_config::message::Grant;

/// What the calling thread asks the kernel for, and what it got.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rights {
    priority_asked: u32,
    core_asked: Option<usize>,
    /// Real-time scheduling.
    pub priority: Grant,
    /// Its own core.
    pub core: Grant,
    /// Memory locked against paging.
    pub memory: Grant,
}

impl Rights {
    /// A wish list; nothing is asked of the kernel yet.
    pub fn asked(priority: u32, core: Option<usize>) -> Self {
        Self {
            priority_asked: priority,
            core_asked: core,
            priority: Grant::Unasked,
            core: Grant::Unasked,
            memory: Grant::Unasked,
        }
    }

    /// The SCHED_FIFO priority asked for; 0 for none.
    pub fn priority_asked(&self) -> u32 {
        self.priority_asked
    }

    /// The SCHED_FIFO priority in force; 0 for none.
    pub fn priority_got(&self) -> u32 {
        match self.priority {
            Grant::Granted => self.priority_asked,
            Grant::Refused | Grant::Unasked => 0,
        }
    }

    /// Asks for everything on the list, for the calling thread.
    pub(crate) fn claim(&mut self) {
        if let Some(core) = self.core_asked {
            self.core = grant(stay_on(core));
        }
        if self.priority_asked == 0 {
            return;
        }
        self.priority = grant(set_fifo(self.priority_asked));
        // Pages are locked as they are first touched: locking the whole address
        // space would also fill the reserved but unused parts of large queues.
        let flags = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT;
        self.memory = grant(mlockall(flags).is_ok());
        // Absolute sleeps of real-time threads have no slack; of others, 50 us.
        let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
    }
}

fn grant(granted: bool) -> Grant {
    if granted {
        Grant::Granted
    } else {
        Grant::Refused
    }
}

fn stay_on(core: usize) -> bool {
    if core >= CpuSet::MAX_CPU {
        return false;
    }
    let mut cores = CpuSet::new();
    cores.set(core);
    sched_setaffinity(None, &cores).is_ok()
}

#[allow(unsafe_code)]
fn set_fifo(priority: u32) -> bool {
    let parameters = libc::sched_param {
        sched_priority: priority as libc::c_int,
    };
    // Threads started later do not inherit the priority.
    let policy = libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK;
    // SAFETY: pid 0 is the calling thread and the parameters live through the call.
    unsafe { libc::sched_setscheduler(0, policy, &parameters) == 0 }
}
