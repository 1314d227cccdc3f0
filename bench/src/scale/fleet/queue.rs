//! A queue with several servers, simulated event by event.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::Serialize;

/// How members send.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sending {
    /// Each in its own period, with a phase of its own.
    Periodic,
    /// At random, as independent events.
    Random,
}

/// A part as a queue.
#[derive(Clone, Copy, Debug)]
pub struct Queue {
    /// Members that send.
    pub members: u64,
    /// Messages of each member, 1/s.
    pub messages_per_s: f64,
    /// Time of one server for a message, s.
    pub service_s: f64,
    /// Servers beside each other.
    pub servers: u64,
    /// Messages that wait at most; a further one is lost and counted.
    pub waiting_max: usize,
    /// How they send.
    pub sending: Sending,
}

/// What became of the messages.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Queued {
    /// Messages sent.
    pub sent: u64,
    /// Messages served.
    pub served: u64,
    /// Messages lost because the queue was full.
    pub lost: u64,
    /// Messages that wait, or are being served, at the end.
    pub left: u64,
    /// Mean wait of the served ones, s.
    pub wait_mean_s: f64,
    /// 99 % quantile of the wait, s.
    pub wait_p99_s: f64,
    /// Share of the servers' time that was used.
    pub utilisation: f64,
}

/// Nanoseconds: events at the same instant are ordered by their kind and number.
type Ns = u64;

fn ns(seconds: f64) -> Ns {
    (seconds * 1e9).round() as Ns
}

/// A uniform number in (0, 1].
fn uniform(stream: &mut Xoshiro256PlusPlus) -> f64 {
    ((stream.next_u64() >> 11) + 1) as f64 / (1u64 << 53) as f64
}

impl Queue {
    /// Simulates so many seconds; the same seed gives the same result.
    pub fn simulate(&self, seconds: f64, seed: u64) -> Queued {
        let mut stream = Xoshiro256PlusPlus::seed_from_u64(seed);
        let period_s = 1.0 / self.messages_per_s;
        let gap = |stream: &mut Xoshiro256PlusPlus| match self.sending {
            Sending::Periodic => ns(period_s),
            Sending::Random => ns(-uniform(stream).ln() * period_s).max(1),
        };
        // The next message of each member.
        let mut sends: BinaryHeap<Reverse<(Ns, u64)>> = (0..self.members)
            .map(|member| {
                let first = match self.sending {
                    Sending::Periodic => ns(uniform(&mut stream) * period_s),
                    Sending::Random => gap(&mut stream),
                };
                Reverse((first, member))
            })
            .collect();
        let (end, service) = (ns(seconds), ns(self.service_s).max(1));
        let mut busy: BinaryHeap<Reverse<Ns>> = BinaryHeap::new();
        let mut waiting: VecDeque<Ns> = VecDeque::new();
        let (mut result, mut waits) = (Queued::default(), Vec::new());
        let mut used: u128 = 0;
        while let Some(Reverse((now, member))) = sends.pop().filter(|Reverse((at, _))| *at < end) {
            // Servers that become free before this message take the oldest waiting one.
            while let Some(Reverse(free)) = busy.peek().copied().filter(|Reverse(at)| *at <= now) {
                busy.pop();
                result.served += 1;
                if let Some(came) = waiting.pop_front() {
                    waits.push(free - came);
                    used += u128::from(service.min(end.saturating_sub(free)));
                    busy.push(Reverse(free + service));
                }
            }
            result.sent += 1;
            if (busy.len() as u64) < self.servers {
                waits.push(0);
                used += u128::from(service.min(end - now));
                busy.push(Reverse(now + service));
            } else if waiting.len() < self.waiting_max {
                waiting.push_back(now);
            } else {
                result.lost += 1;
            }
            sends.push(Reverse((now + gap(&mut stream), member)));
        }
        result.left = (busy.len() + waiting.len()) as u64;
        result.utilisation = used as f64 / (end as f64 * self.servers as f64);
        if !waits.is_empty() {
            waits.sort_unstable();
            let sum: u128 = waits.iter().map(|wait| u128::from(*wait)).sum();
            result.wait_mean_s = sum as f64 * 1e-9 / waits.len() as f64;
            result.wait_p99_s = waits[(waits.len() - 1) * 99 / 100] as f64 * 1e-9;
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn queue(load: f64) -> Queue {
        Queue {
            members: 100,
            messages_per_s: load * 10.0,
            service_s: 1e-3,
            servers: 1,
            waiting_max: usize::MAX,
            sending: Sending::Random,
        }
    }

    #[test]
    fn waits_of_random_messages_are_those_of_theory() {
        for load in [0.3, 0.6, 0.8] {
            let found = queue(load).simulate(400.0, 3);
            // M/D/1: the mean wait is half a service time times load / (1 - load).
            let theory_s = 0.5e-3 * load / (1.0 - load);
            let ratio = found.wait_mean_s / theory_s;
            assert!((0.95..1.05).contains(&ratio), "load {load}: {ratio}");
            assert!((found.utilisation - load).abs() < 0.01, "{found:?}");
        }
    }

    #[test]
    fn each_message_is_served_lost_or_left() {
        for (load, waiting_max) in [
            (0.5, 10),
            (0.99, 10),
            (3.0, 10),
            (3.0, 0),
            (1.5, usize::MAX),
        ] {
            for sending in [Sending::Periodic, Sending::Random] {
                let queue = Queue {
                    waiting_max,
                    sending,
                    servers: 4,
                    service_s: 4e-3,
                    ..queue(load)
                };
                let found = queue.simulate(20.0, 7);
                assert_eq!(
                    found.sent,
                    found.served + found.lost + found.left,
                    "{found:?}"
                );
                assert_eq!(found, queue.simulate(20.0, 7), "the same seed");
                // Without a place to wait, a server idles until the next message.
                if load > 1.0 && waiting_max > 0 {
                    assert!(found.utilisation > 0.99, "{found:?}");
                    let share = found.lost as f64 / found.sent as f64;
                    let is_bounded = waiting_max < usize::MAX;
                    let expected = if is_bounded { 1.0 - 1.0 / load } else { 0.0 };
                    assert!((share - expected).abs() < 0.02, "{load}: {found:?}");
                }
            }
        }
    }

    #[test]
    fn periodic_messages_wait_less_than_random_ones() {
        let random = queue(0.8);
        let periodic = Queue {
            sending: Sending::Periodic,
            ..random
        };
        // The phases of one seed repeat in each period.
        let waits = [periodic, random].map(|queue| {
            let seeds = (0..50).map(|seed| queue.simulate(4.0, seed).wait_mean_s);
            seeds.sum::<f64>() / 50.0
        });
        assert!(waits[0] < waits[1], "{waits:?}");
    }
}
