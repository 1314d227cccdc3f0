//! Each instant of the grid has one tick or counts as skipped, however late a process
//! or its observations are.

use proptest::prelude::*;
use runtime::{Release, TickSchedule};
use shm_config::Instant;
use shm_config::message::Health;

const PERIOD_NS: u64 = 100_000_000;
const WAIT_NS: u64 = 50_000_000;
const START: Instant = Instant(7_000_000_000);

/// The published counts of ticks and skipped instants.
fn accounted(schedule: &TickSchedule) -> (u64, u64) {
    let mut health = Health::default();
    schedule.report(&mut health);
    let elapsed_ns = health.next_scheduled_ns - health.first_scheduled_ns;
    assert_eq!(elapsed_ns % PERIOD_NS, 0);
    assert_eq!(elapsed_ns / PERIOD_NS, health.ticks + health.skipped);
    (health.ticks, health.skipped)
}

proptest! {
    /// Observations are lost or late at random; the controller reads them every few
    /// milliseconds, sometimes much later.
    #[test]
    fn ticks_and_skipped_add_up_to_elapsed(
        arrivals in prop::collection::vec(prop::option::weighted(0.8, 0u64..180_000_000), 1..60),
        looks_ns in prop::collection::vec(1_000_000u64..40_000_000, 1..20),
        stall in 0usize..400,
    ) {
        let mut schedule = TickSchedule::following(PERIOD_NS);
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
                .and_then(|scheduled| schedule.on_observation(Instant(scheduled), Instant(now)))
                .or_else(|| match schedule.deadline(WAIT_NS) {
                    Some(deadline) if Instant(now) >= deadline => schedule.on_timeout(Instant(now), WAIT_NS),
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
            prop_assert_eq!(accounted(&schedule), (ticks, skipped));
        }
    }
}

#[test]
fn a_grid_from_the_future_is_not_followed() {
    let mut schedule = TickSchedule::following(PERIOD_NS);
    assert!(schedule.on_observation(START, START).is_some());
    let far = START.after_ns(3_600_000_000_000);
    assert_eq!(
        schedule.on_observation(far, START.after_ns(PERIOD_NS)),
        None
    );
    let deadline = schedule.deadline(WAIT_NS).expect("the grid is known");
    assert_eq!(deadline, START.after_ns(PERIOD_NS + WAIT_NS));
    let slot = schedule.on_timeout(deadline, WAIT_NS).expect("its turn");
    assert_eq!((slot.release, slot.due), (Release::TimeOut, deadline));
    assert_eq!(slot.scheduled, START.after_ns(PERIOD_NS));
    let next = START.after_ns(2 * PERIOD_NS);
    let slot = schedule.on_observation(next, next).expect("its turn");
    assert_eq!((slot.release, slot.due), (Release::Observation, next));
}

proptest! {
    /// A world with up to ten instants in a tick wakes too late at random.
    #[test]
    fn ticks_and_skipped_add_up_on_a_timer(
        parts in 1u64..=10,
        oversleeps_ns in prop::collection::vec(0u64..250_000_000, 1..60),
    ) {
        let mut schedule = TickSchedule::on_timer(PERIOD_NS, parts, START);
        let mut begun = None;
        for oversleep_ns in oversleeps_ns {
            let now = schedule.now().after_ns(oversleep_ns);
            let index = schedule.index();
            let missed = schedule.miss_until(now);
            prop_assert_eq!(schedule.index(), index + missed);
            prop_assert!(schedule.now() <= now);
            prop_assert!(now.since_ns(schedule.now()) <= schedule.step_ns() + 1);
            if begun != Some(schedule.tick()) {
                begun = Some(schedule.tick());
                schedule.begin();
            }
            schedule.move_on();
            let (ticks, skipped) = accounted(&schedule);
            prop_assert_eq!(ticks + skipped, schedule.index().div_ceil(parts));
        }
    }
}

#[test]
fn a_follower_at_a_lower_rate_begins_its_grid_anew_and_rounds() {
    let mut schedule = TickSchedule::following(PERIOD_NS);
    assert_eq!(schedule.take(START), 0);
    assert_eq!(schedule.take(START.after_ns(PERIOD_NS * 5 / 4)), 0);
    assert_eq!(
        schedule.take(START.after_ns(PERIOD_NS * 5 / 4 + 1)),
        0,
        "earlier than due"
    );
    assert_eq!(
        schedule.take(START.after_ns(PERIOD_NS * 4)),
        2,
        "2.75 periods late"
    );
    assert_eq!((schedule.ticks(), schedule.skipped()), (4, 2));
}
