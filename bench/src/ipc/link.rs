//! The round trips of one connection, equal for all sides.

use anyhow::bail;
use hdrhistogram::Histogram;
use rustix::thread::{ClockId, clock_nanosleep_absolute};
use shm_config::Instant;

use super::arguments::Wake;
use stack::Clock;

/// Polling grid of a receiver with [`Wake::Grid`], ns.
const GRID_NS: u64 = 100_000;
/// A message counts as lost after this time, ns: on a busy machine, a spinning thread
/// may be descheduled for seconds.
pub const LOST_NS: u64 = 30_000_000_000;
/// Polls without a message between two readings of the clock.
const LOOKS: u32 = 1 << 14;
/// Longest time in the histogram, ns.
const LONGEST_NS: u64 = 10_000_000_000;

/// One end of a connection in both directions.
pub trait Link {
    /// Publishes the next message and rings the receiver's doorbell if it has one.
    fn send(&mut self) -> bool;

    /// Takes the newest message; returns whether there was one.
    ///
    /// # Errors
    /// If it was refused.
    fn receive(&mut self) -> anyhow::Result<bool>;

    /// Work between two messages: loans memory for the next one.
    fn update_connections(&mut self);

    /// Sleeps until the doorbell rings or a time limit has passed.
    fn wait(&self);
}

/// Parameters of a block of round trips.
#[derive(Clone, Copy, Debug)]
pub struct RoundTrips {
    /// How the receivers wait.
    pub wake: Wake,
    /// Interval between messages, ns; 0 for as fast as they are answered.
    pub period_ns: u64,
    /// Number of round trips that are not counted, and of those that are.
    pub counts: [u64; 2],
}

/// An empty histogram of one-way times.
///
/// # Errors
/// Never: the bounds are valid.
pub fn histogram() -> anyhow::Result<Histogram<u64>> {
    Ok(Histogram::new_with_bounds(1, LONGEST_NS, 3)?)
}

/// Sends messages, waits for each answer, and records half of each round trip.
///
/// # Errors
/// If a message is lost or refused.
pub fn ping(
    link: &mut impl Link,
    trips: RoundTrips,
    clock: Clock,
    into: &mut Histogram<u64>,
) -> anyhow::Result<()> {
    let [warm, counted] = trips.counts;
    let begun = clock();
    for k in 0..warm + counted {
        if trips.period_ns > 0 {
            sleep_until(begun.after_ns(k * trips.period_ns));
        }
        let sent = clock();
        if !link.send() {
            bail!("a message could not be sent: no shared memory");
        }
        link.update_connections();
        await_message(link, trips.wake, clock)?;
        let round_ns = clock().since_ns(sent);
        if k >= warm {
            into.saturating_record(round_ns / 2);
        }
    }
    Ok(())
}

/// Answers each message.
///
/// # Errors
/// If a message is lost or refused.
pub fn echo(link: &mut impl Link, trips: RoundTrips, clock: Clock) -> anyhow::Result<()> {
    for _ in 0..trips.counts.iter().sum() {
        await_message(link, trips.wake, clock)?;
        if !link.send() {
            bail!("a message could not be sent: no shared memory");
        }
        link.update_connections();
    }
    Ok(())
}

fn await_message(link: &mut impl Link, wake: Wake, clock: Clock) -> anyhow::Result<()> {
    let mut looks = 0_u32;
    let mut until = None;
    while !link.receive()? {
        match wake {
            Wake::Spin => std::hint::spin_loop(),
            Wake::Bell => link.wait(),
            Wake::Grid => sleep_until(Instant((clock().0 / GRID_NS + 1) * GRID_NS)),
        }
        looks += 1;
        if wake != Wake::Spin || looks.is_multiple_of(LOOKS) {
            let now = clock();
            if now > *until.get_or_insert(now.after_ns(LOST_NS)) {
                bail!(
                    "a message did not come within {} s",
                    LOST_NS / 1_000_000_000
                );
            }
        }
    }
    Ok(())
}

fn sleep_until(instant: Instant) {
    let until = instant.timespec();
    while clock_nanosleep_absolute(ClockId::Monotonic, &until).is_err() {}
}
