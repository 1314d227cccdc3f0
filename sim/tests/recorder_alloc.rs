//! Telling the photographer costs a tick no allocation and no waiting, whether or
//! not anybody reads what is told.

use std::alloc::System;

use shm_config::message::Header;
use sim::photographer::{Move, Seen, film};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use vehicle::Action;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

/// Twice as many as the queue holds, an instant and a move each.
const TICKS: u64 = 1 << 16;

#[test]
fn what_nobody_reads_is_dropped_without_an_allocation() {
    let control = Region::new(ALLOCATOR);
    drop(std::hint::black_box(Vec::<u8>::with_capacity(100)));
    assert!(control.change().allocations > 0, "the counter counts");

    let (mut recorder, mut film) = film();
    let region = Region::new(ALLOCATOR);
    for episode in 0..2 {
        recorder.begin(episode, 7);
        for tick in 0..TICKS {
            recorder.saw(Seen {
                tick,
                taken_ns: tick,
                passed: 0.0,
            });
            recorder.moved(Move {
                action: Action::BRAKE,
                substeps: 5,
            });
        }
    }
    let change = region.change();
    assert_eq!((change.allocations, change.reallocations), (0, 0));
    assert_eq!(change.deallocations, 0);

    // It was really told, and really too much.
    film.develop();
    let reel = film.reel(0).expect("the episode");
    let at = |tick| {
        reel.at(&Header {
            tick,
            ..Header::default()
        })
    };
    assert!(at(30_000).is_some() && at(TICKS - 1).is_none());
    assert!(
        film.reel(1).is_none(),
        "there was no room for its beginning"
    );
}
