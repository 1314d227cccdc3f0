//! Following what moves takes no memory and gives none back.

use allocation_counter::measure;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::message::{MOTION_AT_REST, MOTION_FEATURES, Observation};
use tracker::{Sighting, Tracker};

/// A scan of walls at random distances.
fn scene(dice: &mut Xoshiro256PlusPlus) -> Observation {
    let mut observation = Observation {
        beam_count: 240,
        ..Observation::default()
    };
    let beams = observation.ranges_m[..240].chunks_mut(8);
    for wall in beams {
        wall.fill(5.0 + (dice.next_u64() % 60) as f32);
    }
    observation
}

/// Scans with returns, and with bodies that come and go: also after all of its memory of
/// earlier scans is in use.
#[test]
fn no_scan_allocates() {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(1);
    let mut tracker = Tracker::default();
    let (mut sightings, mut moving, mut told) = (0, 0, 0);
    for tick in 0..200 {
        let mut scene = scene(&mut dice);
        scene.header.taken_ns = tick * 100_000_000;
        // A body that drives: beams ahead hit it, a little farther at each tick.
        scene.header.episode = (tick / 50) as u32;
        let ahead_m = 10.0 + 0.6 * (tick % 50) as f32;
        scene.ranges_m[..3].fill(ahead_m);
        scene.ranges_m[237..240].fill(ahead_m);
        let mut motion = [0.0; MOTION_FEATURES];
        let taken = measure(|| {
            tracker.follow(&scene);
            motion = tracker.motion();
        });
        assert_eq!((taken.count_total, taken.count_current), (0, 0), "{tick}");
        sightings += tracker.sightings().len();
        let moves = |sighting: &&Sighting| sighting.moves();
        moving += tracker.sightings().iter().filter(moves).count();
        told += motion.iter().filter(|it| **it != MOTION_AT_REST).count();
    }
    assert!(sightings > 2000, "{sightings} returns");
    assert!(moving > 100, "{moving} of {sightings} returns move");
    assert!(told > 100, "{told} numbers tell of motion");
}
