//! Failing on order, so that a campaign can see what the rest of a set does.

use std::time::Duration;

use shm_config::message::{Fault, FaultKind, Message};
use shm_config::services::{FAULT, Process};
use shm_config::time::monotonic;
use shm_config::wire::{Subscriber, WireError};

use crate::Member;

/// Orders older than this are not obeyed: they were for a predecessor, ns.
const ORDER_AGE_NS: u64 = 1_000_000_000;
/// The longest a loop is made to stand still, ns.
const SLOW_MAX_NS: u64 = 10_000_000_000;

/// Where a process hears that it shall fail; nowhere unless `run.faults` is on.
pub(crate) struct Failing {
    process: Process,
    orders: Option<Subscriber<Fault>>,
}

impl Failing {
    /// Opens the port if the configuration wants it.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub(crate) fn of(member: &Member) -> Result<Self, WireError> {
        let orders = match member.config.run.faults {
            true => Some(member.wire.subscriber(FAULT)?),
            false => None,
        };
        Ok(Self {
            process: member.process,
            orders,
        })
    }

    /// Does what was ordered, which may well be the end.
    // An order may come after any instant that was read before: it would be from
    // the future.
    #[allow(clippy::disallowed_methods)]
    pub(crate) fn obey(&mut self) {
        let Some(orders) = &mut self.orders else {
            return;
        };
        orders.tend();
        while let Some(order) = orders.receive() {
            let is_meant = order.target == self.process.code();
            if is_meant && order.admit(monotonic(), ORDER_AGE_NS).is_ok() {
                fail(&order);
            }
        }
    }
}

fn fail(order: &Fault) {
    match FaultKind::from_code(order.kind) {
        None => {}
        Some(FaultKind::Hang) => loop {
            std::thread::park();
        },
        Some(FaultKind::Spin) => loop {
            std::hint::spin_loop();
        },
        Some(FaultKind::Slow) => {
            let moment = Duration::from_nanos(order.duration_ns.min(SLOW_MAX_NS));
            // The stop on order of a campaign, in no loop that drives.
            #[allow(clippy::disallowed_methods)]
            std::thread::sleep(moment);
        }
        Some(FaultKind::Panic) => panic!("ordered to panic"),
        Some(FaultKind::Allocation) => {
            // More than any machine has: the allocator's own refusal ends the process.
            let bytes: Vec<u8> = Vec::with_capacity(isize::MAX as usize);
            std::hint::black_box(bytes);
        }
    }
}
