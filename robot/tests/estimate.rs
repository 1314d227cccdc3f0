//! The filter against a truth that moves as it assumes: its covariance is that of its
//! errors, and what is late, missing or wrong is treated as its documents say.

#[path = "estimate/refused.rs"]
mod refused;
#[path = "estimate/simulated.rs"]
mod simulated;

use allocation_counter::measure;
use nalgebra::Matrix3;
use refused::{imu, place};
use robot::estimate::{
    ACCEL, Counts, Estimate, Filter, GATE, HEADING, Measurement, Noise, SPEED, STATES, Settings,
    Start, Verdict, X, Y, YAW_RATE,
};
use shm_config::Instant;
use simulated::{Drive, IMU_NS, TICK_NS, Taken, filter, filtered};
use vehicle::pose;

use crate::dice::Dice;

const RUNS: u64 = 200;
const DURATION_S: f64 = 10.0;

/// The bounds within which the mean of so many numbers of chi-square is with a probability
/// of 95 % (Wilson and Hilferty's approximation of the quantiles).
fn bounds(freedoms: usize, count: u64) -> [f64; 2] {
    let sum = (freedoms as u64 * count) as f64;
    [-1.959_964, 1.959_964].map(|normal: f64| {
        let share = 2.0 / (9.0 * sum);
        sum * (1.0 - share + normal * share.sqrt()).powi(3) / count as f64
    })
}

fn is_within(mean: f64, [low, high]: [f64; 2]) -> bool {
    (low..=high).contains(&mean)
}

/// The mean NEES of all drives at each tick after the first second, with the noise that the
/// filter is told multiplied.
fn average_nees(factor: f64) -> Vec<f64> {
    let nees = (0..RUNS).map(|seed| filtered(&Drive::new(seed, DURATION_S), factor).nees);
    let sum = nees.reduce(|sum, nees| sum.iter().zip(&nees).map(|(a, b)| a + b).collect());
    let sum = sum.expect("drives");
    sum.iter().skip(10).map(|sum| sum / RUNS as f64).collect()
}

/// The share of the ticks at which the mean NEES is within its bounds, and the mean of all.
fn consistency(factor: f64) -> (f64, f64) {
    let average = average_nees(factor);
    let bounds = bounds(STATES, RUNS);
    let within = average.iter().filter(|mean| is_within(**mean, bounds));
    let share = within.count() as f64 / average.len() as f64;
    let mean = average.iter().sum::<f64>() / average.len() as f64;
    println!(
        "noise told times {factor}: {share:.3} of the ticks within {bounds:.3?}, mean {mean:.3}"
    );
    (share, mean)
}

#[test]
fn its_covariance_is_that_of_its_errors() {
    let (share, mean) = consistency(1.0);
    assert!(share >= 0.9, "{share} of the ticks are within the bounds");
    assert!(is_within(mean, bounds(STATES, RUNS)), "{mean}");
}

#[test]
fn a_wrong_covariance_leaves_the_bounds() {
    let [low, high] = bounds(STATES, RUNS);
    for factor in [0.5, 0.8] {
        let (share, mean) = consistency(factor);
        assert!(share == 0.0 && mean > high, "{factor}: {share}, {mean}");
    }
    let (share, mean) = consistency(1.25);
    assert!(share == 0.0 && mean < low, "{share}, {mean}");
}

#[test]
fn the_innovations_of_each_sensor_are_as_large_as_it_says() {
    // Of wheels, IMU, motion and place: sums of NIS and of degrees of freedom.
    let mut sums = [(0.0, 0); 4];
    let mut counts = Counts::default();
    for seed in 0..RUNS {
        let filtered = filtered(&Drive::new(seed, DURATION_S), 1.0);
        counts.applied += filtered.counts.applied;
        counts.rejected += filtered.counts.rejected;
        for (measurement, verdict) in filtered.verdicts {
            let sum = match measurement {
                Measurement::Wheels { .. } => &mut sums[0],
                Measurement::Imu { .. } => &mut sums[1],
                Measurement::Motion { .. } => &mut sums[2],
                Measurement::Place { .. } => &mut sums[3],
                Measurement::Keyframe => continue,
            };
            sum.0 += verdict.nis;
            sum.1 += verdict.freedoms;
        }
    }
    for (sum, freedoms) in sums {
        let mean = sum / freedoms as f64;
        let bounds = bounds(1, freedoms as u64);
        println!("{freedoms} numbers: {mean:.4} within {bounds:.4?}");
        assert!(is_within(mean, bounds), "{mean} is outside {bounds:?}");
    }
    // One in a thousand is above its gate.
    let share = counts.rejected as f64 / (counts.applied + counts.rejected) as f64;
    assert!((0.0005..0.002).contains(&share), "{counts:?}");
}

#[test]
fn gross_outliers_are_rejected_and_change_nothing() {
    let drive = Drive::new(1, 5.0);
    let mut clean = filter(1.0);
    let mut dirty = filter(1.0);
    let mut outliers = 0;
    for (k, taken) in drive.taken.iter().enumerate() {
        let verdict = clean.add(taken.at, taken.at, taken.measurement);
        assert!(verdict.is_ok(), "{verdict:?}");
        // A nanosecond before it, so that it is no duplicate.
        let before = Instant(taken.at.0.saturating_sub(1));
        let wrong = match taken.measurement {
            Measurement::Wheels { speed_mps, .. } => Measurement::Wheels {
                speed_mps: speed_mps + 5.0,
                steer_rad: None,
            },
            Measurement::Imu {
                yaw_rate_radps,
                accel_mps2,
            } => Measurement::Imu {
                yaw_rate_radps: yaw_rate_radps - 1.0,
                accel_mps2,
            },
            Measurement::Place {
                world_from_body,
                information,
            } => Measurement::Place {
                world_from_body: pose(10.0, 0.0, 0.0) * world_from_body,
                information,
            },
            Measurement::Motion { .. } | Measurement::Keyframe => {
                dirty
                    .add(taken.at, taken.at, taken.measurement)
                    .expect("it is taken");
                continue;
            }
        };
        if k % 7 == 0 && k > 20 {
            let verdict = dirty.add(taken.at, before, wrong).expect("it is judged");
            let Verdict { nis, freedoms, .. } = verdict;
            assert!(
                !verdict.is_applied && nis > GATE[freedoms - 1],
                "{verdict:?}"
            );
            outliers += 1;
        }
        dirty
            .add(taken.at, taken.at, taken.measurement)
            .expect("it is taken");
    }
    assert!(outliers > 30, "{outliers}");
    assert_eq!(dirty.counts().rejected, clean.counts().rejected + outliers);
    let (at, _) = drive.truth[drive.truth.len() - 1];
    let [clean, dirty] = [clean, dirty].map(|filter| filter.estimate(at).expect("of now"));
    // The prediction to an outlier and on from there is one step more.
    assert!((clean.mean - dirty.mean).amax() < 1e-6);
}

#[test]
fn a_place_that_stays_rejected_is_believed_at_last() {
    let settings = Settings::default();
    let mut filter =
        Filter::new(&settings, &Noise::default(), &Start::default()).expect("a filter");
    // Someone carried the car three metres away: 30 deviations.
    let moved = place(3.0, Matrix3::identity() * 100.0);
    let stand = Measurement::Wheels {
        speed_mps: 0.0,
        steer_rad: Some(0.0),
    };
    for k in 1..=u64::from(settings.places_rejected_max) {
        let now = Instant(k * TICK_NS);
        filter.add(now, now, stand).expect("it is taken");
        let verdict = filter.add(now, now, moved).expect("it is judged");
        assert!(!verdict.is_applied, "{k}: {verdict:?}");
        assert!(filter.estimate(now).expect("of now").mean[X].abs() < 0.1);
    }
    let now = Instant(6 * TICK_NS);
    filter.add(now, now, stand).expect("it is taken");
    let verdict = filter.add(now, now, moved).expect("it is judged");
    assert!(verdict.is_applied && verdict.nis > GATE[2], "{verdict:?}");
    let estimate = filter.estimate(now).expect("of now");
    assert!(
        (estimate.mean[X] - 3.0).abs() < 3.0 * estimate.std(X),
        "{estimate:?}"
    );
    // A wheel that is stuck is never believed.
    let stuck = Measurement::Wheels {
        speed_mps: 100.0,
        steer_rad: None,
    };
    for k in 7..=17 {
        let now = Instant(k * TICK_NS);
        assert!(
            !filter
                .add(now, now, stuck)
                .expect("it is judged")
                .is_applied
        );
    }
}

/// When each measurement arrives: wheels, IMU and places after up to 0.4 s in any order,
/// scans in their own order, all 0.3 s late.
fn arrivals(drive: &Drive, seed: u64) -> Vec<(Instant, Taken)> {
    let mut dice = Dice::new(seed);
    let arrive = drive.taken.iter().map(|taken| {
        let late_s = match taken.measurement {
            Measurement::Motion { .. } | Measurement::Keyframe => 0.3,
            _ => 0.4 * dice.unit(),
        };
        (taken.at.after_ns((late_s * 1e9) as u64), *taken)
    });
    let mut arrivals: Vec<_> = arrive.collect();
    arrivals.sort_by_key(|(arrives, _)| *arrives);
    arrivals
}

/// The estimates at each tick 0.4 s before, when all up to it has arrived.
fn settled(arrivals: &[(Instant, Taken)], ticks: &[Instant]) -> Vec<Estimate> {
    let mut filter = filter(1.0);
    let mut arrivals = arrivals.iter().peekable();
    let mut settled = Vec::new();
    for tick in ticks {
        let now = tick.after_ns(4 * TICK_NS);
        while let Some((arrives, taken)) = arrivals.next_if(|(arrives, _)| *arrives <= now) {
            let verdict = filter.add(*arrives, taken.at, taken.measurement);
            assert!(verdict.is_ok(), "{taken:?}: {verdict:?}");
        }
        settled.push(filter.estimate(*tick).expect("within the history"));
    }
    settled
}

#[test]
fn delayed_measurements_give_the_estimate_of_those_in_order() {
    let drive = Drive::new(2, DURATION_S);
    let ticks: Vec<Instant> = drive.truth.iter().map(|(at, _)| *at).collect();
    let in_order: Vec<_> = drive.taken.iter().map(|taken| (taken.at, *taken)).collect();
    let expected = settled(&in_order, &ticks);
    for seed in 0..10 {
        let arrivals = arrivals(&drive, seed);
        let swapped = arrivals
            .windows(2)
            .filter(|pair| pair[0].1.at > pair[1].1.at);
        assert!(swapped.count() > 100, "they arrive out of order");
        for (late, expected) in settled(&arrivals, &ticks).iter().zip(&expected) {
            let off = (late.mean - expected.mean).amax();
            let spread = (late.covariance - expected.covariance).amax();
            assert!(off < 1e-9 && spread < 1e-9, "seed {seed}: {off} {spread}");
        }
    }
}

#[test]
fn without_sensors_the_covariance_grows_and_holds_the_error() {
    let (begin_s, end_s) = (4.0, 7.0);
    let is_dropped = |at: Instant| {
        let at_s = at.0 as f64 * 1e-9;
        at_s > begin_s && at_s <= end_s
    };
    let (mut beyond, mut numbers) = (0, 0);
    for seed in 0..RUNS {
        let drive = Drive::new(seed, DURATION_S);
        let mut filter = filter(1.0);
        let mut taken = drive.taken.iter().peekable();
        let mut last_std = [0.0; 4];
        for (at, truth) in &drive.truth {
            while let Some(next) = taken.next_if(|next| next.at <= *at) {
                let is_scan = matches!(next.measurement, Measurement::Motion { .. });
                // The first motion after the loss would be since a scan that was lost.
                let is_first = is_scan && is_dropped(Instant(next.at.0 - TICK_NS));
                if !is_dropped(next.at) && !is_first {
                    filter
                        .add(next.at, next.at, next.measurement)
                        .expect("it is taken");
                }
            }
            let estimate = filter.estimate(*at).expect("of now");
            if is_dropped(*at) {
                let std = [X, HEADING, SPEED, YAW_RATE].map(|place| estimate.std(place));
                // The first place depends on the direction of the drive.
                let grows = std
                    .iter()
                    .zip(&last_std)
                    .skip(1)
                    .all(|(std, last)| std > last);
                assert!(grows, "seed {seed} at {at:?}: {std:?} after {last_std:?}");
                last_std = std;
                let error = estimate.error(truth);
                for place in [X, Y, HEADING, SPEED, YAW_RATE, ACCEL] {
                    numbers += 1;
                    beyond += usize::from(error[place].abs() > 3.0 * estimate.std(place));
                }
            }
        }
        let filled = filter
            .estimate(drive.truth[drive.truth.len() - 1].0)
            .expect("of now");
        // Three seconds after the return it knows its place as well as before.
        let place_std_m = filled.std(X).hypot(filled.std(Y));
        assert!(
            place_std_m < 0.3,
            "seed {seed}: {place_std_m} {:?}",
            filter.counts()
        );
    }
    // Of a normal distribution 0.27 % are beyond; the numbers of one drive are not
    // independent, and three seconds turn the heading by 0.15 rad.
    let share = beyond as f64 / numbers as f64;
    println!("{beyond} of {numbers} numbers are beyond three deviations");
    assert!(share < 0.01, "{share}");
}

#[test]
fn no_measurement_allocates() {
    let control = measure(|| drop(std::hint::black_box(vec![1u8; 100])));
    assert_eq!(control.count_total, 1, "the counter counts");
    let drive = Drive::new(3, DURATION_S);
    let arrivals = arrivals(&drive, 3);
    let mut filter = filter(1.0);
    let taken = measure(|| {
        for (arrives, taken) in &arrivals {
            let verdict = filter.add(*arrives, taken.at, taken.measurement);
            assert!(verdict.is_ok());
            assert!(filter.estimate(*arrives).is_ok());
        }
    });
    assert_eq!((taken.count_total, taken.count_current), (0, 0));
    assert!(filter.counts().applied > 800, "{:?}", filter.counts());
}

#[test]
fn a_car_that_stands_keeps_its_heading() {
    let settings = Settings::default();
    let mut filter =
        Filter::new(&settings, &Noise::default(), &Start::default()).expect("a filter");
    let mut dice = Dice::new(5);
    for k in 1..=500 {
        let now = Instant(k * IMU_NS);
        // A gyroscope with a bias of 0.02 rad/s: wheels that stand reveal it.
        let gyro = imu(0.02 + 0.01 * dice.normal(), 0.2 * dice.normal());
        filter.add(now, now, gyro).expect("it is taken");
        let wheels = Measurement::Wheels {
            speed_mps: 0.0,
            steer_rad: Some(0.3),
        };
        filter.add(now, now, wheels).expect("it is taken");
    }
    let estimate = filter.estimate(Instant(500 * IMU_NS)).expect("of now");
    assert!(
        estimate.mean[HEADING].abs() < 3.0 * estimate.std(HEADING),
        "{estimate:?}"
    );
    // Ten seconds of an unknown bias would be 0.2 rad.
    assert!(
        estimate.mean[HEADING].abs() < 0.06,
        "{}",
        estimate.mean[HEADING]
    );
    assert!(estimate.speed_mps().abs() < 0.1);
}
