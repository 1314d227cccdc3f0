//! Drivers over a range of maps, judged as the experiment judges, and
//! strictly: `strict` is arriving without having touched anything, `touched` a
//! contact at any tick, `crash` one at the last tick.
//!
//! `cargo run --release -p sim --example drivers [FIRST_SEED] [EPISODES]`

#[path = "../tests/drivers/mod.rs"]
mod scripted;

use shm_config::message::{Observation, Outcome};
use sim::idm::Idm;
use sim::{World, WorldConfig, WorldError};
use vehicle::Action;

#[derive(Debug, Default)]
struct Tally {
    arrived: u64,
    strict: u64,
    touched: u64,
    touched_vehicle: u64,
    touched_object: u64,
    crash: u64,
    out_of_road: u64,
    max_step: u64,
    completion: f64,
    ticks: u64,
    driven_m: f64,
}

fn main() -> Result<(), WorldError> {
    let mut numbers = std::env::args()
        .skip(1)
        .filter_map(|word| word.parse().ok());
    let first_seed = numbers.next().unwrap_or(100);
    let episodes = numbers.next().unwrap_or(50);
    println!("maps {first_seed} to {}", first_seed + episodes - 1);
    println!(
        "driver       success strict touched (vehicle/object) crash  out of road  max step  \
         completion  length   m/s"
    );
    let mut world = World::new(WorldConfig::default())?;
    let mut observation = Observation::default();
    let mut idm = Idm::new(0, 0);
    let drive = |world: &mut World, ticks: u64| {
        if ticks == 0 {
            let seed = world.seed();
            // The timer begins anywhere below 50 steps, as in the simulator.
            idm = Idm::new((seed.wrapping_mul(31) % 50) as u32, seed);
        }
        world.advise(&mut idm)
    };
    print(
        "idm",
        episodes,
        &tally(&mut world, first_seed, episodes, drive)?,
    );
    let drive = |world: &mut World, _| {
        world.observe(&mut observation);
        scripted::keep_lane(&observation)
    };
    print(
        "lane keeper",
        episodes,
        &tally(&mut world, first_seed, episodes, drive)?,
    );
    let mut noise = scripted::Noise(first_seed);
    let drive = |_: &mut World, _| noise.action();
    print(
        "random",
        episodes,
        &tally(&mut world, first_seed, episodes, drive)?,
    );
    Ok(())
}

fn tally(
    world: &mut World,
    first_seed: u64,
    episodes: u64,
    mut drive: impl FnMut(&mut World, u64) -> Action,
) -> Result<Tally, WorldError> {
    let mut tally = Tally::default();
    for seed in first_seed..first_seed + episodes {
        world.reset(seed)?;
        let (mut vehicle, mut object) = (false, false);
        while !world.last_step().has_ended() {
            let action = drive(world, world.ticks());
            let touch = world.step(action).touch;
            vehicle |= touch.vehicle;
            object |= touch.object;
        }
        let last = world.last_step();
        match last.outcome {
            Outcome::Arrived => tally.arrived += 1,
            Outcome::OutOfRoad => tally.out_of_road += 1,
            Outcome::MaxStep => tally.max_step += 1,
            Outcome::Driving | Outcome::Stopped => {}
        }
        let touched = vehicle || object;
        tally.strict += u64::from(last.outcome == Outcome::Arrived && !touched);
        tally.touched += u64::from(touched);
        tally.touched_vehicle += u64::from(vehicle);
        tally.touched_object += u64::from(object);
        tally.crash += u64::from(last.touch.vehicle || last.touch.object);
        tally.completion += world.completion();
        tally.ticks += world.ticks();
        tally.driven_m += world.driven_m();
        if std::env::var_os("EACH_EPISODE").is_some() {
            println!("seed {seed}: {last:?} after {} ticks", world.ticks());
        }
    }
    Ok(tally)
}

fn print(name: &str, episodes: u64, tally: &Tally) {
    let share = |count: u64| count as f64 / episodes as f64;
    println!(
        "{name:12} {:7.2} {:6.2} {:7.2} ({:.2}/{:.2}) {:12.2} {:12.2} {:9.2} {:11.3} {:7.0} {:5.1}",
        share(tally.arrived),
        share(tally.strict),
        share(tally.touched),
        share(tally.touched_vehicle),
        share(tally.touched_object),
        share(tally.crash),
        share(tally.out_of_road),
        share(tally.max_step),
        tally.completion / episodes as f64,
        share(tally.ticks),
        tally.driven_m / (tally.ticks as f64 * 0.1),
    );
}
