//! Failures on order: what a campaign of faults does to a process from within.
//!
//! The fault orders are read in a wrapper around the health port, which is installed
//! with `run.faults` alone. Without it no port is open and no branch is taken.

use std::time::Duration;

use shm_config::message::{Fault, FaultKind, Health, Message};
use shm_config::services::{FAULT, Process};
use shm_config::time::Clock;
use shm_config::wire::{Publisher, Subscriber, WireError};

use crate::Member;
use crate::telemetry::HealthPort;

/// Orders older than this are ignored: they were for a predecessor, ns.
const ORDER_AGE_NS: u64 = 1_000_000_000;
/// The longest a loop is made to stand still, ns.
const SLOW_MAX_NS: u64 = 10_000_000_000;

/// A health port whose process fails on order.
pub(crate) struct FaultyPort {
    port: Publisher<Health>,
    process: Process,
    orders: Subscriber<Fault>,
    clock: Clock,
}

impl FaultyPort {
    /// Wraps the port of this process.
    ///
    /// # Errors
    /// When shared memory refuses.
    pub(crate) fn around(port: Publisher<Health>, member: &Member) -> Result<Self, WireError> {
        Ok(Self {
            port,
            process: member.process,
            orders: member.wire.subscriber(FAULT)?,
            clock: member.clock,
        })
    }
}

impl HealthPort for FaultyPort {
    /// Does what was ordered, which may end the process, and publishes.
    fn publish(&mut self, health: &mut Health) {
        self.orders.update_connections();
        while let Some(order) = self.orders.receive() {
            let is_meant = order.target == self.process.code();
            // Read after the order came, which else would be from the future.
            if is_meant && order.admit((self.clock)(), ORDER_AGE_NS).is_ok() {
                fail(&order);
            }
        }
        self.port.publish(health);
    }
    fn update_connections(&mut self) {
        self.port.update_connections();
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
