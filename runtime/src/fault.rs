//! Failures on order: what a fault campaign makes a process do.
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

/// Orders older than this are ignored, ns: they were sent to a predecessor.
const ORDER_AGE_NS: u64 = 1_000_000_000;
/// The longest time for which a loop is stopped, ns.
const SLOW_MAX_NS: u64 = 10_000_000_000;

/// A health port that reads fault orders and fails as ordered.
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
    /// Carries out the newest order, which may end the process, and publishes.
    fn publish(&mut self, health: &mut Health) {
        self.orders.update_connections();
        while let Some(order) = self.orders.receive() {
            let is_meant = order.target == self.process.code();
            // The clock is read after the order arrived; otherwise the order would seem
            // to come from the future.
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
            // Only a fault campaign orders this stop; no loop that drives blocks here.
            #[allow(clippy::disallowed_methods)]
            std::thread::sleep(moment);
        }
        Some(FaultKind::Panic) => panic!("ordered to panic"),
        Some(FaultKind::Allocation) => {
            // More memory than any machine has: the allocator refuses it, which ends
            // the process.
            let bytes: Vec<u8> = Vec::with_capacity(isize::MAX as usize);
            std::hint::black_box(bytes);
        }
    }
}
