//! Back and forth over one connection: what is the same for all that are compared.

use anyhow::bail;
use hdrhistogram::Histogram;
use rustix::thread::{ClockId, clock_nanosleep_absolute};
use shm_config::Instant;

use super::arguments::Wake;
use stack::Clock;

/// Instants at which a receiver with [`Wake::Grid`] looks, ns apart.
const GRID_NS: u64 = 100_000;
/// A message that does not come within this is lost, ns: on a machine with much
/// other work, a spinning thread is descheduled for seconds.
pub const LOST_NS: u64 = 30_000_000_000;
/// Looks without a message between two looks at the clock.
const LOOKS: u32 = 1 << 14;
/// Longest time that the histogram resolves, ns.
const LONGEST_NS: u64 = 10_000_000_000;

/// One end of a connection in both directions.
pub trait Link {
    /// Publishes the next message; the receiver's bell rings where it has one.
    fn send(&mut self) -> bool;

    /// Takes the newest message; whether there was one.
    ///
    /// # Errors
    /// When it was not admitted.
    fn receive(&mut self) -> anyhow::Result<bool>;

    /// What is done between two messages: room for the next one.
    fn update_connections(&mut self);

    /// Sleeps until the bell rings, or a moment has passed.
    fn wait(&self);
}

/// How the two ends take turns.
#[derive(Clone, Copy, Debug)]
pub struct Turns {
    /// What the receivers do.
    pub wake: Wake,
    /// From message to message, ns; 0 for flat out.
    pub period_ns: u64,
    /// Round trips that are not counted, then those that are.
    pub counts: [u64; 2],
}

/// An empty histogram of one-way times.
///
/// # Errors
/// Never with these bounds.
pub fn histogram() -> anyhow::Result<Histogram<u64>> {
    Ok(Histogram::new_with_bounds(1, LONGEST_NS, 3)?)
}

/// Sends, waits for the answer, and counts half of each round trip.
///
/// # Errors
/// When a message is lost or refused.
pub fn ping(
    link: &mut impl Link,
    turns: Turns,
    clock: Clock,
    into: &mut Histogram<u64>,
) -> anyhow::Result<()> {
    let [warm, counted] = turns.counts;
    let begun = clock();
    for k in 0..warm + counted {
        if turns.period_ns > 0 {
            sleep_until(begun.after_ns(k * turns.period_ns));
        }
        let sent = clock();
        if !link.send() {
            bail!("a message could not be sent: no shared memory");
        }
        link.update_connections();
        await_message(link, turns.wake, clock)?;
        let round_ns = clock().since_ns(sent);
        if k >= warm {
            into.saturating_record(round_ns / 2);
        }
    }
    Ok(())
}

/// Answers each message with one.
///
/// # Errors
/// When a message is lost or refused.
pub fn echo(link: &mut impl Link, turns: Turns, clock: Clock) -> anyhow::Result<()> {
    for _ in 0..turns.counts.iter().sum() {
        await_message(link, turns.wake, clock)?;
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
