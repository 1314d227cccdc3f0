//! The evaluation's expert gives the same commands as the process set, bit for bit.

use shm_config::Instant;
use shm_config::config::Config;
use sim::{World, WorldConfig};
use stack::driver::{DriverKind, EpisodeDriver};
use stack::episode::drive;
use supervisor::telemetry::episodes::command_digest;
use vlaps_tests::Set;

#[test]
fn an_evaluated_episode_gives_the_commands_of_the_processes() {
    let config = Config::default();
    let mut world = World::new(WorldConfig::from(&config)).expect("the default world");
    // Planning times have no effect on a command.
    let clock = || Instant(0);
    let mut driver =
        EpisodeDriver::new(DriverKind::Expert, &config, clock).expect("the default planner");
    // A driver's second episode must equal that of a new driver.
    for seed in [1000_u64, 1007] {
        let task = (seed, config.run.period_ns());
        let episode = drive(&mut world, &mut driver, task, |_| {}).expect("a map");
        let set = Set::new("evaluation");
        let number = seed.to_string();
        let output = set.run(&[
            "--lockstep",
            "--gate",
            "expert",
            "--seed",
            &number,
            "--episodes",
            "1",
        ]);
        assert!(output.status.success(), "{output:?}\n{}", set.logs());
        let json = set.json();
        assert!(episode.ticks > 50, "seed {seed}: it drove");
        assert_eq!(json["episodes"][0]["ticks"], episode.ticks, "seed {seed}");
        assert_eq!(
            json["command_digest"].as_str(),
            Some(command_digest(std::iter::once(&episode)).as_str()),
            "seed {seed}"
        );
    }
}
