//! Messages of which bytes were changed, cut off or made up: they are refused, or what passes
//! is finite and within range.

mod stage;

use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_xoshiro::Xoshiro256PlusPlus;
use vlaps_ros::frames::{Frames, Place};
use vlaps_ros::inbound::{LaserScan, Odometry, Path, Refused, Transform};
use vlaps_ros::type_hash::rihs01;

use stage::{odometry, path, scan, transform};

/// Messages that are tried of each kind and seed.
const TRIES: usize = 20_000;

/// Feeds a decoder with damaged copies of a message and with noise; `check` gets what passes.
fn damage<T>(
    whole: &[u8],
    decode: impl Fn(&[u8]) -> Result<T, Refused>,
    check: impl Fn(&T),
) -> usize {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(7);
    let mut refused = 0;
    for _ in 0..TRIES {
        let mut bytes = whole.to_vec();
        match dice.random_range(0..4) {
            0 => bytes.truncate(dice.random_range(0..=whole.len())),
            1 => dice.fill_bytes(&mut bytes[4..]),
            2 => {
                // A word of a length or a number.
                let at = dice.random_range(0..bytes.len() - 3);
                let value: u32 = dice.random();
                bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
            }
            _ => {
                for _ in 0..8 {
                    let at = dice.random_range(0..bytes.len());
                    bytes[at] ^= 1 << dice.random_range(0..8);
                }
            }
        }
        match decode(&bytes) {
            Ok(passed) => check(&passed),
            Err(_) => refused += 1,
        }
    }
    decode(whole)
        .map(|whole| check(&whole))
        .expect("undamaged, it passes");
    refused
}

#[test]
fn a_damaged_scan_is_refused_or_within_range() {
    let refused = damage(&scan(1, "laser", 3.0), LaserScan::decode, |scan| {
        let is_range = |range_m: &f32| range_m.is_nan() || *range_m >= 0.0;
        assert!(scan.ranges_m.iter().all(is_range));
        assert!(scan.first_rad.is_finite() && scan.increment_rad > 0.0);
        assert!((1..=16_384).contains(&scan.ranges_m.len()));
    });
    assert!((TRIES / 10..TRIES).contains(&refused), "{refused}");
}

#[test]
fn damaged_odometry_is_refused_or_within_range() {
    let refused = damage(
        &odometry(1, [1.0, 2.0, 3.0], 4.0),
        Odometry::decode,
        |odometry| {
            let at = odometry.pose.translation.vector;
            assert!(at.iter().all(|along_m| along_m.abs() <= 1e6));
            assert!(odometry.pose.rotation.angle().is_finite());
            assert!(odometry.speed_mps.abs() <= 150.0);
            assert!(odometry.yaw_rate_radps.abs() <= 100.0);
        },
    );
    assert!((TRIES / 10..TRIES).contains(&refused), "{refused}");
}

#[test]
fn damaged_transforms_and_paths_are_refused_or_within_range() {
    damage(
        &transform("a", "b", [1.0, 2.0, 3.0]),
        Transform::decode_all,
        |transforms| {
            assert!(transforms.len() <= 256);
            let mut frames = Frames::default();
            let _ = frames.note(transforms.clone());
            if let Place::Known(pose) = frames.place("b", "a") {
                assert!(
                    pose.translation
                        .vector
                        .iter()
                        .all(|along_m| along_m.is_finite())
                );
            }
        },
    );
    damage(
        &path("map", &[[0.0, 1.0], [2.0, 3.0]]),
        Path::decode,
        |path| {
            let places = path.places.iter();
            let mut numbers = places.flat_map(|place| [place.x, place.y]);
            assert!(numbers.all(|along_m| along_m.abs() <= 1e6));
        },
    );
}

#[test]
fn numbers_that_are_none_and_lists_that_are_too_long_are_refused() {
    for [x_m, heading_rad] in [
        [f64::NAN, 0.0],
        [f64::INFINITY, 0.0],
        [1e7, 0.0],
        [0.0, f64::NAN],
    ] {
        assert!(Odometry::decode(&odometry(1, [x_m, 0.0, heading_rad], 0.0)).is_err());
        assert!(Transform::decode_all(&transform("a", "b", [x_m, 0.0, heading_rad])).is_err());
    }
    for speed_mps in [f64::NAN, f64::NEG_INFINITY, 151.0] {
        assert!(Odometry::decode(&odometry(1, [0.0; 3], speed_mps)).is_err());
    }
    let many = vec![[0.0, 0.0]; 10_001];
    assert_eq!(
        Path::decode(&path("map", &many)),
        Err(Refused("a list of it is too long"))
    );
    let empty = Path::decode(&path("map", &[])).expect("an empty path is one");
    assert!(empty.places.is_empty());
    // Nothing was met.
    for range_m in [f32::INFINITY, 31.0] {
        let scan = LaserScan::decode(&scan(1, "laser", range_m)).expect("a scan");
        assert!(
            scan.ranges_m
                .iter()
                .all(|range_m| *range_m == f32::INFINITY)
        );
    }
    // Nothing was measured: a scanner that is covered or broken does not see a free way.
    for range_m in [f32::NAN, -1.0, 0.0, 0.04] {
        assert!(
            LaserScan::decode(&scan(1, "laser", range_m)).is_err(),
            "{range_m}"
        );
    }
    let near = LaserScan::decode(&scan(1, "laser", f32::NEG_INFINITY)).expect("a scan");
    assert!(near.ranges_m.iter().all(|range_m| *range_m == 0.05));
}

#[test]
fn some_ranges_may_be_errors_and_more_than_half_may_not() {
    let with_errors = |count: usize| {
        let mut ranges_m = [3.0; 360];
        ranges_m[..count].fill(f32::NAN);
        LaserScan::decode(&stage::scan_of(1, "laser", &ranges_m))
    };
    for count in [1, 180] {
        let scan = with_errors(count).expect("a scan");
        let errors = scan.ranges_m.iter().filter(|range_m| range_m.is_nan());
        assert_eq!(errors.count(), count);
        assert_eq!(scan.ranges_m[359], 3.0);
    }
    let refused = with_errors(181).expect_err("a broken scanner");
    assert!(refused.0.contains("NaN"), "{refused}");
}

#[test]
fn a_definition_of_noise_is_refused_or_hashed() {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(9);
    let letters: Vec<char> = "abfloat3264[]/_ \n=MSG:\"{}ü0".chars().collect();
    for _ in 0..TRIES {
        let length = dice.random_range(0..60);
        let text = (0..length).map(|_| letters[dice.random_range(0..letters.len())]);
        let _ = rihs01("a/msg/B", &text.collect::<String>());
    }
}
