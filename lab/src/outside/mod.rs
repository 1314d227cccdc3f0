//! Drives many episodes in a world that is a separate process: such as the real MetaDrive.
//!
//! Each thread starts one world for its share of the seeds, as a run of its own, and
//! answers every observation in lockstep, as the controller does.

mod drive;
mod world;

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use anyhow::Context;
use shm_config::config::{Clock as RunClock, Config, GateMode, Simulator};
use supervisor::cli::failure::Failure;
use supervisor::machine::signals::Signals;
use supervisor::setup::foreign::Foreign;

use crate::episodes::{DrivenEpisode, Task};
use stack::Clock;
use stack::driver::DriverKind;

/// Maximum sleep between two checks for a signal.
const LOOK: Duration = Duration::from_millis(50);
/// Time limit of a world for a command, s: longer than any plan takes on a busy machine,
/// since a world that brakes meanwhile would distort the result.
const PATIENCE_S: f64 = 60.0;

/// The seeds of one world: the first, and their number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Share {
    first_seed: u64,
    episodes: u64,
}

/// Drives all episodes in the simulator of the task; hands over each finished episode, in
/// any order. A signal to stop ends all worlds.
///
/// # Errors
/// If the driver needs the built-in world, the simulator is not set up, a world ends early,
/// or a stop is requested; the first error of `done`.
pub fn evaluate(
    task: &Task,
    config: &Config,
    clock: Clock,
    mut done: impl FnMut(DrivenEpisode) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    if task.driver == DriverKind::Idm {
        let world = task.world.word();
        let line = format!(
            "--driver idm: it needs the built-in world; with --world {world} use expert or lane"
        );
        return Err(Failure::Usage(line).into());
    }
    let foreign = Foreign::of(task.world).context("a simulator with a process of its own")?;
    let program = foreign.world()?;
    let mut signals = Signals::install().context("cannot handle signals")?;
    let (send, ended) = mpsc::channel();
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let workers: Vec<_> = (shares(task).into_iter().enumerate())
            .map(|(index, share)| {
                let (program, stop, send) = (&program, &stop, send.clone());
                let config = resolved(config, task.world, (index, share));
                scope.spawn(move || {
                    let driven = drive::drive(task.driver, (&config?, program), clock, stop, &send);
                    // Without this world's figures, those of the others are useless.
                    stop.fetch_or(driven.is_err(), Ordering::Relaxed);
                    driven
                })
            })
            .collect();
        drop(send);
        let mut kept = Ok(());
        loop {
            match ended.recv_timeout(LOOK) {
                Ok(driven) if kept.is_ok() => kept = done(driven),
                Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            let is_over = signals.take_stops() > 0 || kept.is_err();
            stop.fetch_or(is_over, Ordering::Relaxed);
        }
        for worker in workers {
            match worker.join() {
                Ok(worked) => worked?,
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        kept?;
        match stop.load(Ordering::Relaxed) {
            true => Err(Failure::GivenUp("stopped by a signal".into()).into()),
            false => Ok(()),
        }
    })
}

/// Splits the seeds into one non-empty part per thread.
fn shares(task: &Task) -> Vec<Share> {
    let worlds = (task.threads.get() as u64).clamp(1, task.episodes.max(1));
    let from = |world: u64| task.episodes * world / worlds;
    (0..worlds)
        .map(|world| Share {
            first_seed: task.first_seed.wrapping_add(from(world)),
            episodes: from(world + 1) - from(world),
        })
        .collect()
}

/// The configuration for the run of one world.
fn resolved(
    config: &Config,
    simulator: Simulator,
    (index, share): (usize, Share),
) -> anyhow::Result<Config> {
    let mut config = config.clone();
    config.run.name = format!("eval-{}-{index}", std::process::id());
    config.run.clock = RunClock::Lockstep;
    config.run.seed = share.first_seed;
    config.run.episodes = u32::try_from(share.episodes).context("--episodes")?;
    config.run.duration_s = 0.0;
    config.limits.lockstep_wait_s = PATIENCE_S;
    config.world.simulator = simulator;
    config.gate.mode = GateMode::Expert;
    // MetaDrive refuses another car than its own.
    Ok(config.validated()?)
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroUsize;

    use super::*;

    #[test]
    fn shares_cover_every_seed_once() {
        for (episodes, threads) in [(1, 4), (4, 4), (7, 3), (50, 2)] {
            let task = Task {
                driver: DriverKind::Lane,
                world: Simulator::MetaDrive,
                first_seed: 1000,
                episodes,
                threads: NonZeroUsize::new(threads).expect("not zero"),
            };
            let mut next = 1000;
            for share in shares(&task) {
                assert_eq!(share.first_seed, next);
                assert!(share.episodes > 0);
                next += share.episodes;
            }
            assert_eq!(next, 1000 + episodes);
        }
    }
}
