//! Scenes that were never driven, and the expert's answers there.

mod steps;

use learner::imagine::Imagination;
use learner::replay::Transition;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use shm_config::config::Config;
use shm_config::message::{FEATURES, MOTION_AT_REST};
use steps::step;
use vehicle::Action;

const SCENES: u64 = 30;

/// Imagined scenes around steps in which nothing moves.
fn scenes(motion: bool, imagined_cars: u32) -> (Imagination, Vec<Transition>) {
    let mut config = Config::default();
    config.learner.motion = motion;
    config.learner.imagined_cars = imagined_cars;
    let mut imagination = Imagination::new(&config).expect("an expert");
    let mut random = Xoshiro256PlusPlus::seed_from_u64(1);
    let scenes = (0..SCENES).map(|tick| {
        let observation = step(tick).observation;
        imagination.watch(&observation);
        imagination.disturb(&observation, &mut random)
    });
    let scenes = scenes.collect();
    (imagination, scenes)
}

fn moves(scene: &Transition) -> bool {
    let motion = &scene.state[FEATURES..];
    motion.iter().any(|feature| *feature != MOTION_AT_REST)
}

#[test]
fn cars_that_drive_are_told_to_the_policy_and_only_if_asked() {
    for (motion, cars) in [(false, 0), (false, 3), (true, 0)] {
        let (_, scenes) = scenes(motion, cars);
        assert!(!scenes.iter().any(moves), "motion {motion}, {cars} cars");
    }
    let (mut imagination, with_cars) = scenes(true, 3);
    let moving = with_cars.iter().filter(|scene| moves(scene)).count() as u64;
    assert!(moving > SCENES / 3, "{moving} of {SCENES}");
    assert!(moving < SCENES, "now and then there is no car");
    let features = with_cars.iter().flat_map(|scene| scene.state);
    assert!(
        features
            .into_iter()
            .all(|feature| (0.0..=1.0).contains(&feature))
    );

    // The next states know nothing of the cars that were imagined before.
    let observation = step(SCENES).observation;
    imagination.watch(&observation);
    let rejected = Action {
        steer: 0.0,
        pedal: 0.5,
    };
    let mut predicted = 0;
    imagination.predict(&observation, (rejected, 4), |state| {
        assert!(!moves(&state));
        predicted += 1;
    });
    assert_eq!(predicted, 4);
}

#[test]
fn the_same_seed_imagines_the_same() {
    let [first, again] = [(), ()].map(|()| scenes(true, 2).1);
    assert!(first == again);
}
