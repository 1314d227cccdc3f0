//! The first observation of every recorded seed, feature by feature.

mod recorded;

use shm_config::message::Observation;
use sim::{World, WorldConfig};

const TOLERANCE: f64 = 1e-3;

#[test]
fn first_observations_equal_the_recorded_ones() {
    let Some(folder) = recorded::folder() else {
        return;
    };
    let golden = recorded::golden(&folder);
    let mut world = World::new(WorldConfig::default()).expect("the default world");
    let mut observation = Observation::default();
    let mut features = [0.0_f32; 259];
    let mut wrong = Vec::new();
    for seed in recorded::FIRST_SEED..recorded::FIRST_SEED + recorded::SEEDS {
        world.reset(seed).expect("a recorded seed has a map");
        world.observe(&mut observation);
        observation
            .features(&mut features)
            .expect("259 features fit");
        let expected = golden[seed.to_string()]["obs0"].as_array().expect("obs0");
        assert_eq!(expected.len(), features.len(), "seed {seed}");
        for (index, (value, &ours)) in expected.iter().zip(&features).enumerate() {
            let theirs = value.as_f64().expect("a number");
            if (theirs - f64::from(ours)).abs() > TOLERANCE {
                wrong.push(format!("seed {seed} feature {index}: {ours} for {theirs}"));
            }
        }
    }
    assert!(
        wrong.is_empty(),
        "{} differ:\n{}",
        wrong.len(),
        wrong.join("\n")
    );
}
