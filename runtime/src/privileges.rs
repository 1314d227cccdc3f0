//! Real-time privileges of the tick's thread: those it asks for and those it got.

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use shm_config::message::{Grant, Scheduling};

use crate::kernel::{keep_heap, own_scheduling, set_fifo};

/// Stack that is touched before the first tick, bytes. The deepest tick, that of MPC,
/// uses a tenth of it.
const STACK_BYTES: usize = 512 << 10;
/// Heap that is touched before the first tick and kept, bytes. A tick allocates
/// nothing, but code between ticks does (connecting to a restarted peer).
const HEAP_BYTES: usize = 1 << 20;

/// What a process asks the kernel for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Ask {
    /// `SCHED_FIFO` priority; 0 for no privilege at all.
    pub priority: u32,
    /// Core to stay on, if that priority is set.
    pub core: Option<usize>,
}

/// What the calling thread asks the kernel for, and what it got.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Privileges {
    ask: Ask,
    /// The scheduling in force, as the kernel reports it.
    pub scheduling: Scheduling,
    priority_got: u32,
    /// Real-time scheduling.
    pub priority: Grant,
    /// Its own core.
    pub core: Grant,
    /// Memory locked against paging.
    pub memory: Grant,
}

impl Privileges {
    /// The privileges to ask for; nothing is asked of the kernel yet.
    pub fn asked(ask: Ask) -> Self {
        Self {
            ask,
            scheduling: Scheduling::Ordinary,
            priority_got: 0,
            priority: Grant::Unasked,
            core: Grant::Unasked,
            memory: Grant::Unasked,
        }
    }

    /// The SCHED_FIFO priority asked for; 0 for none.
    pub fn priority_asked(&self) -> u32 {
        self.ask.priority
    }

    /// The SCHED_FIFO priority in force; 0 for none.
    pub fn priority_got(&self) -> u32 {
        self.priority_got
    }

    /// The scheduling asked for.
    pub fn scheduling_asked(&self) -> Scheduling {
        match self.ask.priority {
            0 => Scheduling::Ordinary,
            _ => Scheduling::Fifo,
        }
    }

    /// Asks for all these privileges for the calling thread, and reads back from the
    /// kernel which are in force.
    pub(crate) fn apply(&mut self) {
        if self.ask.priority == 0 {
            return;
        }
        // What the kernel grants is read back.
        let _ = set_fifo(self.ask.priority);
        (self.scheduling, self.priority_got) = own_scheduling();
        self.priority = grant(self.scheduling == Scheduling::Fifo);
        if let Some(core) = self.ask.core {
            self.core = grant(stay_on(core));
        }
        // Pages are locked when they are first touched. Locking the whole address space
        // would also fill the reserved but unused parts of large queues.
        let flags = MlockAllFlags::CURRENT | MlockAllFlags::FUTURE | MlockAllFlags::ONFAULT;
        self.memory = grant(mlockall(flags).is_ok());
        touch_stack();
        keep_heap();
        touch_heap();
        // Timed waits of real-time threads have no slack; those of other threads have
        // 50 us.
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
    let asked = sched_setaffinity(None, &cores).is_ok();
    asked && sched_getaffinity(None).is_ok_and(|got| got == cores)
}

/// Keeps the calling thread, and those that it starts later, on these cores; on any where
/// there are none.
pub(crate) fn stay_among(cores: &[usize]) {
    let mut among = CpuSet::new();
    let usable = cores.iter().filter(|core| **core < CpuSet::MAX_CPU);
    usable.for_each(|core| among.set(*core));
    if among.count() > 0 {
        let _ = sched_setaffinity(None, &among);
    }
}

/// Touches the pages of the stack, so that no tick faults on them.
#[inline(never)]
fn touch_stack() {
    let mut bytes = [0u8; STACK_BYTES];
    std::hint::black_box(&mut bytes);
}

/// Touches the pages of the heap, which keeps freed memory.
fn touch_heap() {
    let bytes = vec![1u8; HEAP_BYTES];
    drop(std::hint::black_box(bytes));
}
