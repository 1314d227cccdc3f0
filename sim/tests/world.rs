//! Properties of every episode, with any driver.

use std::num::NonZeroUsize;
use std::time::Duration;

use shm_config::message::{FEATURES, Observation, Outcome};
use sim::spawn::ObstacleKind;
use sim::world::BodyKind;
use sim::{AfterEnd, Batch, BatchConfig, World, WorldConfig, WorldError};
use vehicle::Action;

use crate::drivers;

fn world() -> World {
    World::new(WorldConfig::default()).expect("the default world")
}

/// The bits of all observation fields that a world fills.
fn bits(world: &World) -> Vec<u64> {
    let mut observation = Observation::default();
    world.observe(&mut observation);
    let ego = observation.ego;
    let numbers = [
        ego.x_world_m,
        ego.y_world_m,
        ego.heading_world_rad,
        ego.speed_mps,
        ego.yaw_rate_radps,
        world.completion(),
        world.driven_m(),
    ];
    let ranges = observation
        .ranges()
        .iter()
        .map(|range_m| u64::from(range_m.to_bits()));
    numbers
        .iter()
        .map(|number| number.to_bits())
        .chain(ranges)
        .collect()
}

#[test]
fn random_driving_keeps_every_number_finite_and_in_range() {
    let mut world = world();
    let mut observation = Observation::default();
    let mut features = [0.0; FEATURES];
    let mut noise = drivers::Noise(7);
    let (mut ticks, mut touched, mut ended) = (0, 0, 0);
    for seed in 0..60 {
        world.reset(seed).expect("a map");
        // The noise begins with a push forward, so that the car does not stand still.
        for tick in 0..300 {
            let mut action = noise.action();
            if tick % 50 < 30 {
                action.pedal = action.pedal.abs();
                action.steer *= 0.1;
            }
            let step = world.step(action);
            world.observe(&mut observation);
            shm_config::Message::check(&observation)
                .unwrap_or_else(|refusal| panic!("seed {seed} tick {tick}: {refusal}"));
            let features = observation.features(&mut features).expect("features fit");
            let good = features.iter().all(|feature| (0.0..=1.0).contains(feature));
            assert!(good, "seed {seed} tick {tick}: {features:?}");
            ticks += 1;
            touched += u32::from(step.touch.vehicle || step.touch.object);
            if step.has_ended() {
                ended += 1;
                break;
            }
        }
    }
    assert!(
        ticks > 3000 && ended > 10,
        "{ticks} ticks, {ended} ended, {touched} in contact"
    );
}

#[test]
fn the_same_seed_is_the_same_episode() {
    let (mut fresh, mut used) = (world(), world());
    for _ in 0..50 {
        used.step(Action {
            steer: 0.1,
            pedal: 1.0,
        });
    }
    for seed in [3, 104, 1007] {
        fresh.reset(seed).expect("a map");
        used.reset(seed).expect("a map");
        let (mut a, mut b) = (drivers::Noise(seed), drivers::Noise(seed));
        for tick in 0..200 {
            assert_eq!(bits(&fresh), bits(&used), "seed {seed} tick {tick}");
            assert_eq!(
                fresh.step(a.action()),
                used.step(b.action()),
                "seed {seed} tick {tick}"
            );
        }
    }
}

/// A batch asks for the memory of the next worlds, which must change nothing.
#[test]
fn a_batch_drives_world_by_world_as_each_drives_alone() {
    const WORLDS: usize = 7;
    let config = BatchConfig {
        worlds: NonZeroUsize::new(WORLDS).expect("seven"),
        threads: NonZeroUsize::MIN,
        after_end: AfterEnd::Restart {
            stride: WORLDS as u64,
        },
    };
    let mut batch = Batch::new(&WorldConfig::default(), config, 300).expect("a batch");
    let mut alone: Vec<World> = (300..300 + WORLDS as u64)
        .map(|seed| {
            let mut world = world();
            world.reset(seed).expect("every seed has a map");
            world
        })
        .collect();
    let mut actions = [Action::default(); WORLDS];
    let mut restarts = 0;
    for tick in 0..400 {
        batch.visit(|k, report| {
            actions[k] = drivers::keep_lane(report.observation);
            actions[k].pedal = 1.0;
        });
        batch.step(&actions).expect("every seed has a map");
        for (world, &action) in alone.iter_mut().zip(&actions) {
            if world.step(action).has_ended() {
                let next = world.seed() + WORLDS as u64;
                world.reset(next).expect("every seed has a map");
                restarts += 1;
            }
        }
        batch.visit(|k, report| {
            assert_eq!(
                bits(report.world),
                bits(&alone[k]),
                "world {k}, tick {tick}"
            );
        });
    }
    assert!(restarts > 0, "episodes end and begin anew");
}

#[test]
fn threads_do_not_change_a_bit() {
    let run = |threads: usize| {
        let config = BatchConfig {
            worlds: NonZeroUsize::new(5).expect("five"),
            threads: NonZeroUsize::new(threads).expect("a thread"),
            after_end: AfterEnd::Restart { stride: 5 },
        };
        let mut batch = Batch::new(&WorldConfig::default(), config, 100).expect("a batch");
        let mut actions = vec![Action::default(); batch.len()];
        let mut restarts = 0;
        for tick in 0..400 {
            if tick % 100 == 0 {
                // The threads fall asleep, and the next step has to wake them.
                std::thread::park_timeout(Duration::from_millis(20));
            }
            batch.visit(|k, report| {
                actions[k] = drivers::keep_lane(report.observation);
                actions[k].pedal = 1.0;
                restarts += u32::from(report.outcome.has_ended());
            });
            batch.step(&actions).expect("every seed has a map");
        }
        let mut all = Vec::new();
        batch.visit(|_, report| all.push((report.world.seed(), bits(report.world))));
        assert!(restarts > 0, "episodes end and begin anew");
        all
    };
    let alone = run(1);
    assert_eq!(alone, run(2));
    assert_eq!(alone, run(5));
}

#[test]
fn after_the_end_nothing_moves() {
    let mut world = world();
    while !world.last_step().has_ended() {
        world.step(Action {
            steer: 1.0,
            pedal: 1.0,
        });
    }
    let (last, before) = (world.last_step(), bits(&world));
    assert_eq!(last.outcome, Outcome::OutOfRoad);
    let ticks = world.ticks();
    for _ in 0..10 {
        assert_eq!(
            world.step(Action {
                steer: 0.0,
                pedal: 1.0
            }),
            last
        );
    }
    assert_eq!((bits(&world), world.ticks()), (before, ticks));
}

#[test]
fn the_horizon_ends_an_episode() {
    let config = WorldConfig {
        horizon_steps: 12,
        ..WorldConfig::default()
    };
    let mut world = World::new(config).expect("a world");
    for tick in 1..=12 {
        let step = world.step(Action::BRAKE);
        let expected = if tick < 12 {
            Outcome::Driving
        } else {
            Outcome::MaxStep
        };
        assert_eq!(step.outcome, expected, "tick {tick}");
    }
}

#[test]
fn a_non_finite_action_brakes() {
    for action in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY].map(|bad| Action {
        steer: 0.0,
        pedal: bad,
    }) {
        let (mut bad, mut braking) = (world(), world());
        for _ in 0..20 {
            bad.step(Action {
                steer: 0.0,
                pedal: 1.0,
            });
            braking.step(Action {
                steer: 0.0,
                pedal: 1.0,
            });
        }
        for _ in 0..5 {
            bad.step(action);
            braking.step(Action::BRAKE);
        }
        assert_eq!(bits(&bad), bits(&braking), "{action:?}");
    }
}

#[test]
fn an_invalid_configuration_is_refused() {
    let config = |change: fn(&mut WorldConfig)| {
        let mut config = WorldConfig::default();
        change(&mut config);
        World::new(config).err()
    };
    let refused = |change| config(change).expect("refused").to_string();
    assert!(refused(|c| c.scanner.beams = 2049).starts_with("scanner.beams = 2049"));
    assert!(refused(|c| c.vehicle.length_m = 0.0).starts_with("vehicle.length_m = 0"));
    assert_eq!(config(|c| c.horizon_steps = 0), Some(WorldError::Horizon));
    assert!(config(|c| c.scanner.range_m = f64::NAN).is_some());
    assert!(config(|c| c.block_sequence = "SZ".into()).is_some());
    assert!(config(|c| c.traffic_density = -0.1).is_some());
    assert!(config(|c| c.lane_count = 0).is_some());
    assert_eq!(config(|c| c.block_sequence = "SCO".into()), None);
}

#[test]
fn no_car_can_be_driven_through() {
    let mut world = world();
    let mut observation = Observation::default();
    let mut hits = 0;
    for seed in 100..150 {
        world.reset(seed).expect("a map");
        while !world.last_step().has_ended() && world.ticks() < 400 {
            world.observe(&mut observation);
            let mut action = drivers::keep_lane(&observation);
            action.pedal = 1.0;
            hits += u32::from(world.step(action).touch.vehicle);
            let ego = world.ego_seen();
            for body in world.bodies() {
                let is_car = match body.kind {
                    BodyKind::Traffic(_) | BodyKind::Obstacle(ObstacleKind::BrokenDown(_)) => true,
                    BodyKind::Obstacle(_) => false,
                };
                let away_m = (body.placed.center_world - ego.center_world).norm();
                let tick = world.ticks();
                assert!(
                    !is_car || away_m > 1.2,
                    "seed {seed} tick {tick}: {away_m} m"
                );
            }
        }
    }
    assert!(hits > 20, "{hits} ticks in contact");
}

#[test]
fn five_substeps_with_one_command_are_one_tick_bit_for_bit() {
    let (mut whole, mut parts) = (world(), world());
    let mut noise = drivers::Noise(11);
    for seed in [3, 17, 1004] {
        whole.reset(seed).expect("a map");
        parts.reset(seed).expect("a map");
        for tick in 0..150 {
            let mut action = noise.action();
            action.pedal = action.pedal.abs();
            action.steer *= 0.2;
            let expected = whole.step(action);
            for substep in 1..5 {
                assert_eq!(parts.substep(action), None, "sub-step {substep}");
            }
            assert_eq!(parts.substep(action), Some(expected));
            assert_eq!(bits(&whole), bits(&parts), "seed {seed} tick {tick}");
            if expected.has_ended() {
                break;
            }
        }
    }
}

#[test]
fn a_new_command_takes_effect_within_a_tick() {
    let drive = Action {
        steer: 0.0,
        pedal: 1.0,
    };
    let (mut whole, mut parts) = (world(), world());
    for world in [&mut whole, &mut parts] {
        world.reset(3).expect("a map");
        for _ in 0..20 {
            world.step(drive);
        }
    }
    whole.step(drive);
    parts.substep(drive);
    parts.substep(drive);
    parts.step(Action::BRAKE);
    assert_eq!(
        whole.ticks(),
        parts.ticks(),
        "step ends the tick that has begun"
    );
    assert!(
        parts.speed_mps() < whole.speed_mps() - 0.5,
        "{} m/s with three sub-steps of brake, {} m/s without",
        parts.speed_mps(),
        whole.speed_mps()
    );
    let mut observation = Observation::default();
    parts.observe(&mut observation);
    assert_eq!(observation.ego.pedal, -1.0, "the one obeyed last");
}

#[test]
fn poses_between_two_substeps_lie_between_theirs() {
    let mut world = world();
    world.reset(3).expect("a map");
    let action = Action {
        steer: 0.3,
        pedal: 0.8,
    };
    for _ in 0..15 {
        world.step(action);
    }
    let seen = |world: &World, passed: f64| {
        let mut observation = Observation::default();
        world.observe_between(passed, &mut observation);
        shm_config::Message::check(&observation).expect("well formed");
        observation.ego
    };
    for substep in 0..12 {
        let (before, middle, near) = (
            seen(&world, 0.0),
            seen(&world, 0.5),
            seen(&world, 1.0 - 1e-9),
        );
        world.substep(action);
        let after = seen(&world, 0.0);
        let half = |a: f64, b: f64| (a + b) / 2.0;
        let rows = [
            (middle.x_world_m, half(before.x_world_m, after.x_world_m)),
            (middle.y_world_m, half(before.y_world_m, after.y_world_m)),
            (
                middle.heading_world_rad,
                half(before.heading_world_rad, after.heading_world_rad),
            ),
            (
                middle.yaw_rate_radps,
                half(before.yaw_rate_radps, after.yaw_rate_radps),
            ),
            (near.x_world_m, after.x_world_m),
            (near.heading_world_rad, after.heading_world_rad),
            (near.yaw_rate_radps, after.yaw_rate_radps),
        ];
        for (row, (got, expected)) in rows.into_iter().enumerate() {
            let error = (got - expected).abs();
            assert!(
                error < 1e-5,
                "sub-step {substep} row {row}: {got} for {expected}"
            );
        }
        assert!(after.x_world_m != before.x_world_m, "the car moves");
    }
}
