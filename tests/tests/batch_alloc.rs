//! A batch of worlds allocates nothing within episodes, on one thread and on two: the
//! memory of all ticks is reserved when an episode begins.

use std::alloc::System;
use std::num::NonZeroUsize;

use shm_config::message::Outcome;
use sim::{AfterEnd, Batch, BatchConfig, WorldConfig};
use stack::lane_keeper::keep_lane;
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use vehicle::Action;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const WORLDS: usize = 16;
const FIRST_SEED: u64 = 100;
/// Ticks in which threads and locks, also those of the test harness, may still be
/// initialised.
const WARM_UP: u64 = 20;
const TICKS: u64 = 200;

/// What the ticks did; it shows that the count of zero is meaningful.
#[derive(Debug, Default)]
struct Done {
    metres: f64,
    driving: usize,
    moved: usize,
    allocations: usize,
}

fn drive(threads: usize) -> Done {
    let settings = BatchConfig {
        worlds: NonZeroUsize::new(WORLDS).expect("not zero"),
        threads: NonZeroUsize::new(threads).expect("not zero"),
        after_end: AfterEnd::Stay,
    };
    let mut batch = Batch::new(&WorldConfig::default(), settings, FIRST_SEED).expect("a batch");
    let mut actions = [Action::default(); WORLDS];
    let mut done = Done::default();
    for tick in 0..WARM_UP + TICKS {
        let region = Region::new(ALLOCATOR);
        batch.visit(|k, report| actions[k] = keep_lane(report.observation));
        batch.step(&actions).expect("threads that live");
        let change = region.change();
        if tick >= WARM_UP {
            done.allocations += change.allocations + change.reallocations;
        }
    }
    batch.visit(|_, report| {
        done.metres += report.world.driven_m();
        done.driving += usize::from(report.outcome.outcome == Outcome::Driving);
        let still = |body: &sim::world::Body| body.velocity_world.norm() < 1.0;
        done.moved += report.world.bodies().filter(|body| !still(body)).count();
    });
    done
}

/// A single test, because the counter counts the whole program.
#[test]
fn two_hundred_steps_of_sixteen_worlds_allocate_nothing() {
    let control = Region::new(ALLOCATOR);
    drop(std::hint::black_box(Vec::<u8>::with_capacity(100)));
    assert!(control.change().allocations > 0, "the counter counts");
    for threads in [1, 2] {
        let done = drive(threads);
        // More than 60 m each on average, and traffic that has started.
        assert!(
            done.metres > 1_000.0 && done.driving > WORLDS / 2 && done.moved > 0,
            "{threads} threads: {done:?}"
        );
        assert_eq!(
            done.allocations, 0,
            "allocations and reallocations in {TICKS} steps on {threads} threads: {done:?}"
        );
    }
}
