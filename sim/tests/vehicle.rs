//! The built-in world obeys the vehicle and the scanner of its configuration.

use proptest::prelude::*;
use shm_config::message::Observation;
use sim::dynamics::{Car, Motion};
use sim::lidar::Lidar;
use sim::model::VehicleKind;
use sim::spawn::ScanNoise;
use sim::{World, WorldConfig};
use vehicle::{Action, Scanner, Vehicle};

const PEDAL: Action = Action {
    steer: 0.0,
    pedal: 1.0,
};

fn world(vehicle: Vehicle, scanner: Scanner) -> World {
    let config = WorldConfig {
        vehicle,
        scanner,
        traffic_density: 0.0,
        accident_probability: 0.0,
        ..WorldConfig::default()
    };
    let mut world = World::new(config).expect("a world");
    world.reset(3).expect("a map");
    world
}

fn hold(world: &mut World, action: Action, ticks: u32) {
    for _ in 0..ticks {
        world.step(action);
    }
}

fn observation(world: &World) -> Box<Observation> {
    let mut observation = Box::<Observation>::default();
    world.observe(&mut observation);
    observation
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// The limit holds for the speed that an observation shows, however the car is driven.
    #[test]
    fn no_car_exceeds_its_top_speed(
        top_mps in 0.5..30.0f64, wheelbase_m in 0.2..6.0f64,
        actions in prop::collection::vec((-1.0..1.0f64, -0.2..1.0f64), 1..40),
    ) {
        let vehicle = Vehicle { max_speed_mps: top_mps, wheelbase_m, length_m: 7.0, ..Vehicle::default() };
        let mut world = world(vehicle, Scanner::default());
        for (steer, pedal) in actions {
            for _ in 0..5 {
                world.step(Action { steer, pedal });
                prop_assert!(world.speed_mps() <= top_mps + 1e-9, "{}", world.speed_mps());
            }
        }
    }
}

#[test]
fn a_car_limited_to_2_mps_drives_2_mps_and_the_default_faster() {
    let after = |vehicle: Vehicle| {
        let mut world = world(vehicle, Scanner::default());
        hold(&mut world, PEDAL, 60);
        world.speed_mps()
    };
    let slow = Vehicle {
        max_speed_mps: 2.0,
        ..Vehicle::default()
    };
    assert!((after(slow) - 2.0).abs() < 1e-9);
    assert!(after(Vehicle::default()) > 3.6);
}

#[test]
fn acceleration_brake_and_turn_are_those_of_the_file() {
    let vehicle = Vehicle {
        length_m: 0.568,
        width_m: 0.296,
        wheelbase_m: 0.33,
        max_steer_deg: 24.0,
        max_accel_mps2: 4.0,
        max_brake_mps2: 6.0,
        max_speed_mps: 7.0,
        delay_ms: 0.0,
    };
    let mut world = world(vehicle, Scanner::default());
    let ego = world.ego_seen();
    assert!((ego.shape.radius_m() - vehicle.footprint().radius_m()).abs() < 1e-12);
    hold(&mut world, PEDAL, 5);
    assert!(
        (world.speed_mps() - 4.0 * 0.5).abs() < 1e-9,
        "{}",
        world.speed_mps()
    );
    world.step(Action::BRAKE);
    assert!((world.speed_mps() - (2.0 - 0.6)).abs() < 1e-9);
    let left = Action {
        steer: 1.0,
        pedal: 0.0,
    };
    hold(&mut world, left, 5);
    let seen = observation(&world);
    // The centre's radius: the rear axle's, and half the wheelbase across.
    let rear_m = vehicle.wheelbase_m / vehicle.max_steer_rad().tan();
    let radius_m = seen.ego.speed_mps / seen.ego.yaw_rate_radps;
    let expected_m = rear_m.hypot(vehicle.wheelbase_m / 2.0);
    assert!(
        (radius_m - expected_m).abs() < 1e-3,
        "{radius_m} for {expected_m}"
    );
}

#[test]
fn a_delay_moves_the_effect_and_nothing_else() {
    let delayed = |delay_ms: f64| {
        let mut world = world(
            Vehicle {
                delay_ms,
                ..Vehicle::default()
            },
            Scanner::default(),
        );
        let speeds = (0..40).map(|tick| {
            let action = match tick < 20 {
                true => PEDAL,
                false => Action::BRAKE,
            };
            world.step(action);
            world.speed_mps()
        });
        speeds.collect::<Vec<f64>>()
    };
    let (now, later) = (delayed(0.0), delayed(200.0));
    let top = |speeds: &[f64]| {
        speeds
            .iter()
            .copied()
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let (at_now, at_later) = (top(&now).expect("speeds").0, top(&later).expect("speeds").0);
    assert_eq!(at_later, at_now + 2, "the brake comes two ticks later");
}

#[test]
fn sub_steps_and_ticks_agree_with_a_delay() {
    let vehicle = Vehicle {
        delay_ms: 60.0,
        ..Vehicle::default()
    };
    let (mut ticks, mut substeps) = (
        world(vehicle, Scanner::default()),
        world(vehicle, Scanner::default()),
    );
    for tick in 0..50 {
        let action = Action {
            steer: 0.3 * f64::from(tick % 3 - 1),
            pedal: 0.5,
        };
        ticks.step(action);
        for _ in 0..5 {
            let _ = substeps.substep(action);
        }
        assert_eq!(ticks.ego_motion(), substeps.ego_motion(), "tick {tick}");
    }
}

#[test]
fn the_default_car_is_metadrives() {
    let forces = world(Vehicle::default(), Scanner::default())
        .ego_car()
        .forces;
    assert_eq!(
        Car::ego(&Vehicle::default(), forces),
        Car::new(VehicleKind::Default, forces)
    );
    let delayed = Vehicle {
        delay_ms: 100.0,
        ..Vehicle::default()
    };
    assert_eq!(
        Car::ego(&delayed, forces),
        Car::new(VehicleKind::Default, forces)
    );
    let wide = Vehicle {
        width_m: 2.0,
        ..Vehicle::default()
    };
    let car = Car::ego(&wide, forces);
    assert_eq!(car, Car::ego(&wide, forces));
    let mut motion = Motion::at_rest(vehicle::pose(1.0, 2.0, 0.5), car.model);
    car.tick(&mut motion, Action::BRAKE);
    assert!(
        (motion.body_position() - vehicle::Point::new(1.0, 2.0)).norm() < 1e-12,
        "it stands"
    );
}

#[test]
fn a_scan_says_where_its_beams_look_and_drops_its_share() {
    let scanner = Scanner {
        beams: 1080,
        field_of_view_deg: 270.0,
        x_m: 1.5,
        heading_deg: 10.0,
        ..Scanner::default()
    };
    let config = |drop_probability: f64| WorldConfig {
        scanner: Scanner {
            drop_probability,
            ..scanner
        },
        ..WorldConfig::default()
    };
    for seed in 0..20 {
        let scan = |drop_probability: f64| {
            let mut world = World::new(config(drop_probability)).expect("a world");
            world.reset(seed).expect("a map");
            hold(&mut world, PEDAL, 20);
            observation(&world)
        };
        let (all, some, again) = (scan(0.0), scan(0.25), scan(0.25));
        assert_eq!(all.fan(), scanner.fan());
        assert_eq!(some.ranges(), again.ranges(), "the same of one seed");
        for (all_m, some_m) in all.ranges().iter().zip(some.ranges()) {
            assert!(some_m == all_m || *some_m == 50.0);
        }
    }
    let lidar = Lidar::new(&config(0.25).scanner);
    let mut dropped = 0;
    for instant in 0..100 {
        let mut ranges_m = [10.0; 1080];
        lidar.disturb((7, instant), &mut ranges_m);
        dropped += ranges_m.iter().filter(|&&range_m| range_m == 50.0).count();
    }
    let share = f64::from(dropped as u32) / 108_000.0;
    assert!((0.24..0.26).contains(&share), "{share}");
}

#[test]
fn the_ranges_of_a_noisy_scan_deviate_and_no_free_beam_becomes_a_return() {
    let mut lidar = Lidar::new(&Scanner::default());
    let noise = ScanNoise {
        drop_probability: 0.0,
        range_m: 0.1,
    };
    lidar.begin(noise);
    let scan = |lidar: &Lidar, instant: u64| {
        let mut ranges_m = [10.0; 240];
        ranges_m[..40].fill(50.0);
        lidar.disturb((7, instant), &mut ranges_m);
        ranges_m
    };
    assert_eq!(scan(&lidar, 1), scan(&lidar, 1), "the same of one seed");
    let mut squares = 0.0;
    for instant in 0..100 {
        let ranges_m = scan(&lidar, instant);
        assert!(ranges_m[..40].iter().all(|range_m| *range_m == 50.0));
        let off = ranges_m[40..]
            .iter()
            .map(|range_m| f64::from(range_m - 10.0));
        squares += off.map(|off| off * off).sum::<f64>();
    }
    let mut far_and_near = [49.99; 240];
    far_and_near[..40].fill(0.01);
    lidar.disturb((7, 1), &mut far_and_near);
    let reach = 0.0..=50.0;
    assert!(far_and_near.iter().all(|range_m| reach.contains(range_m)));
    let deviation_m = (squares / 20_000.0_f64).sqrt();
    assert!((0.098..0.102).contains(&deviation_m), "{deviation_m}");
    // The next episode has no noise.
    lidar.begin(ScanNoise::default());
    assert!(scan(&lidar, 1)[40..].iter().all(|range_m| *range_m == 10.0));
}
