//! What always-on measurement costs: times the same empty tick with and without it,
//! alternating.
//!
//! `cargo run --release -p runtime --example measuring`

use std::hint::black_box;

use runtime::Usage;
use shm_config::message::{Measure, Timing};
use shm_config::time::monotonic;

/// Ticks in one round.
const TICKS: u64 = 200_000;
/// Rounds of each kind; the median is reported.
const TURNS: usize = 15;
/// Instants at which a controller's tick takes the time of its parts, as in the
/// process.
const INSTANTS: usize = 5;

#[allow(clippy::disallowed_methods)] // an entry point reads the clock
fn main() {
    let mut timing = Box::<Timing>::default();
    let mut copy = Box::<Timing>::default();
    let [mut with, mut without, mut usage, mut copied] = [const { Vec::new() }; 4];
    for _ in 0..TURNS {
        with.push(ns_per_tick(|tick| measured_tick(&mut timing, tick)));
        without.push(ns_per_tick(|tick| {
            black_box(tick);
        }));
        usage.push(ns_per_tick(|_| {
            black_box(Usage::of_this_thread());
        }));
        copied.push(ns_per_tick(|tick| {
            if tick.is_multiple_of(100) {
                *copy = **black_box(&timing);
                black_box(&copy);
            }
        }));
    }
    let [with, without] = [median(with), median(without)];
    println!("a tick measured: {with:.0} ns, not measured: {without:.0} ns");
    println!("so measuring costs {:.0} ns a tick", with - without);
    println!(
        "between ticks, 20 times a second: page faults and switches, {:.0} ns",
        median(usage)
    );
    println!(
        "between ticks, twice a second: histograms copied, {:.0} ns",
        median(copied) * 100.0
    );
}

/// A tick like the controller's: one instant at the end of each part, seven durations.
#[allow(clippy::disallowed_methods)] // an entry point reads the clock
fn measured_tick(timing: &mut Timing, tick: u64) {
    let mut last = monotonic();
    for _ in 1..INSTANTS {
        let now = monotonic();
        black_box(now.since_ns(last) > tick);
        last = now;
    }
    for measure in Measure::ALL {
        // The values spread over some thousand buckets; the durations of a run spread
        // over tens.
        timing
            .of_mut(*measure)
            .record(tick.wrapping_mul(7919) & 0xf_ffff);
    }
}

#[allow(clippy::disallowed_methods)] // an entry point reads the clock
fn ns_per_tick(mut tick: impl FnMut(u64)) -> f64 {
    let begun = monotonic();
    for number in 0..TICKS {
        tick(number);
    }
    monotonic().since_ns(begun) as f64 / TICKS as f64
}

fn median(mut all: Vec<f64>) -> f64 {
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}
