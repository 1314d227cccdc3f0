//! A million ticks of random driving over a thousand seeds: no panic, and every number
//! stays finite and in range.
//!
//! `cargo run --release -p sim --example random_steps`

#[path = "../tests/drivers/mod.rs"]
mod drivers;

use shm_config::message::{FEATURES, Observation};
use sim::{World, WorldConfig, WorldError};

const SEEDS: u64 = 1000;
const TICKS: u64 = 1000;

fn main() -> Result<(), WorldError> {
    let mut world = World::new(WorldConfig::default())?;
    let mut observation = Observation::default();
    let mut features = [0.0; FEATURES];
    let mut noise = drivers::Noise(1);
    let (mut ticks, mut bad, mut ended, mut contacts) = (0_u64, 0_u64, 0_u64, 0_u64);
    for seed in 0..SEEDS {
        world.reset(seed)?;
        for tick in 0..TICKS {
            let mut action = noise.action();
            // Half of the time the noise is biased forward: uniform noise hardly leaves
            // the first road.
            if tick % 100 < 50 {
                action.pedal = action.pedal.abs();
                action.steer *= 0.2;
            }
            let step = world.step(action);
            world.observe(&mut observation);
            let fine = shm_config::Message::check(&observation).is_ok()
                && observation
                    .features(&mut features)
                    .is_some_and(|all| all.iter().all(|one| (0.0..=1.0).contains(one)));
            bad += u64::from(!fine);
            contacts += u64::from(step.touch.vehicle || step.touch.object);
            ticks += 1;
            if step.has_ended() {
                ended += 1;
                world.reset(seed)?;
            }
        }
    }
    println!(
        "{ticks} ticks over {SEEDS} seeds: {bad} bad, {ended} episodes ended, {contacts} in contact"
    );
    assert_eq!(bad, 0, "an observation left its limits");
    Ok(())
}
