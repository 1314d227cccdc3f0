//! One tick for each instant of the grid, however observations come.

use controller::{Release, Slots};
use proptest::prelude::*;
use shm_config::Instant;

const PERIOD_NS: u64 = 100_000_000;
const WAIT_NS: u64 = 50_000_000;
const START: Instant = Instant(7_000_000_000);

proptest! {
    /// Observations are lost or come late at random; the controller looks every
    /// few milliseconds, sometimes much later.
    #[test]
    fn ticks_and_skipped_add_up_to_elapsed(
        arrivals in prop::collection::vec(prop::option::weighted(0.8, 0u64..180_000_000), 1..60),
        looks_ns in prop::collection::vec(1_000_000u64..40_000_000, 1..20),
        stall in 0usize..400,
    ) {
        let mut slots = Slots::new(PERIOD_NS, WAIT_NS);
        // (arrival, scheduled) in order of arrival; the newest wins.
        let mut coming: Vec<(u64, u64)> = arrivals.iter().enumerate().filter_map(|(k, late)| {
            let scheduled = START.0 + k as u64 * PERIOD_NS;
            late.map(|late| (scheduled + late, scheduled))
        }).collect();
        coming.sort_unstable();
        let end = START.0 + arrivals.len() as u64 * PERIOD_NS;
        let (mut now, mut ticks, mut skipped, mut first, mut last) = (START.0, 0u64, 0u64, None, 0);
        let mut look = 0;
        while now < end {
            let arrived: Vec<_> = coming.iter().copied().filter(|(at, _)| *at <= now).collect();
            coming.retain(|(at, _)| *at > now);
            let newest = arrived.iter().map(|(_, scheduled)| *scheduled).max();
            let slot = newest
                .and_then(|scheduled| slots.on_observation(Instant(scheduled), Instant(now)))
                .or_else(|| match slots.deadline() {
                    Some(deadline) if Instant(now) >= deadline => slots.on_timeout(Instant(now)),
                    _ => None,
                });
            if let Some(slot) = slot {
                prop_assert!(slot.scheduled.0 > last, "no slot has two ticks");
                prop_assert!(slot.scheduled.0 <= now);
                last = slot.scheduled.0;
                first.get_or_insert(slot.scheduled.0);
                ticks += 1;
                skipped += slot.skipped;
            }
            look += 1;
            let pause = looks_ns[look % looks_ns.len()];
            now += if look == stall { 730_000_000 } else { pause };
        }
        if let Some(first) = first {
            prop_assert_eq!((last - first) / PERIOD_NS + 1, ticks + skipped);
        }
    }
}

#[test]
fn a_grid_from_the_future_is_not_followed() {
    let mut slots = Slots::new(PERIOD_NS, WAIT_NS);
    assert!(slots.on_observation(START, START).is_some());
    let far = START.after_ns(3_600_000_000_000);
    assert_eq!(slots.on_observation(far, START.after_ns(PERIOD_NS)), None);
    let deadline = slots.deadline().expect("the grid is known");
    assert_eq!(deadline, START.after_ns(PERIOD_NS + WAIT_NS));
    let slot = slots.on_timeout(deadline).expect("its turn");
    assert_eq!((slot.release, slot.due), (Release::TimeOut, deadline));
    assert_eq!(slot.scheduled, START.after_ns(PERIOD_NS));
    let next = START.after_ns(2 * PERIOD_NS);
    let slot = slots.on_observation(next, next).expect("its turn");
    assert_eq!((slot.release, slot.due), (Release::Observation, next));
}
