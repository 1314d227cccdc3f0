//! Drives whole episodes in the order of a lockstep run, as `./vlaps eval` does.

use std::sync::Mutex;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use controller::Terms;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use shm_config::Instant;
use shm_config::config::Config;
use shm_config::message::Episode;
use sim::{World, WorldConfig};
use stack::driver::{DriverKind, EpisodeDriver};
use stack::episode::drive;

use crate::expert::config;
use crate::options::Options;

/// The process's clock; only measured planning times depend on it.
#[allow(clippy::disallowed_methods)] // the entry point of a Python program
pub fn clock() -> Instant {
    static BEGUN: OnceLock<std::time::Instant> = OnceLock::new();
    let begun = BEGUN.get_or_init(std::time::Instant::now);
    Instant(begun.elapsed().as_nanos() as u64)
}

/// The driver of all episodes.
#[derive(FromPyObject)]
pub enum Driver {
    /// A driver by its name in `./vlaps eval --driver`.
    #[pyo3(transparent)]
    Named(String),
    /// The policy in these bytes.
    #[pyo3(transparent)]
    Policy(Vec<u8>),
}

impl Driver {
    fn load(&self, config: &Config) -> Result<EpisodeDriver, String> {
        match self {
            Driver::Named(name) => {
                let kind: DriverKind = name.parse()?;
                EpisodeDriver::new(kind, config, clock).map_err(|error| format!("{error:#}"))
            }
            Driver::Policy(bytes) => {
                let terms = Terms {
                    config,
                    version: 1,
                    clock,
                };
                let policy = controller::build(bytes, &terms).map_err(|error| error.to_string())?;
                Ok(EpisodeDriver::of_policy(policy, clock))
            }
        }
    }
}

/// Seed, outcome, ticks, completion, driven length in m, ticks in contact with a vehicle
/// and with an object, and whether the last tick touched anything.
type Account = (u64, &'static str, u64, f64, f64, u64, u64, bool);

fn account(episode: &Episode) -> Account {
    (
        episode.seed,
        episode.outcome().word(),
        episode.ticks,
        episode.completion,
        episode.driven_m,
        episode.vehicle_contacts,
        episode.object_contacts,
        episode.crash_last_step != 0,
    )
}

/// Episodes, and the histogram of planning times: upper bounds in us with counts.
type Driven = (Vec<Account>, Vec<(u64, u64)>);

/// Drives the episodes of seeds until none is left.
fn work(
    (driver, seeds): (&Driver, &[u64]),
    (world, config): (&WorldConfig, &Config),
    (next, ended): (&AtomicUsize, &Mutex<Driven>),
) -> Result<(), String> {
    let mut world = World::new(world.clone()).map_err(|error| error.to_string())?;
    let mut driver = driver.load(config)?;
    let mut accounts = Vec::new();
    while let Some(&seed) = seeds.get(next.fetch_add(1, Ordering::Relaxed)) {
        let episode = drive(
            &mut world,
            &mut driver,
            (seed, config.run.period_ns()),
            |_| {},
        );
        accounts.push(account(&episode.map_err(|error| error.to_string())?));
    }
    let mut ended = ended.lock().map_err(|_| "another thread has failed")?;
    ended.0.extend(accounts);
    let times = driver.planning_us().iter_recorded();
    ended
        .1
        .extend(times.map(|class| (class.value_iterated_to(), class.count_at_value())));
    Ok(())
}

/// Drives the episode of each seed in lockstep order with the given number of threads; the
/// result is in the order of the seeds.
#[pyfunction]
pub fn drive_seeds(
    py: Python,
    driver: Driver,
    seeds: Vec<u64>,
    options: &str,
    changes: &str,
    threads: usize,
) -> PyResult<Driven> {
    let options = Options::parse(options).map_err(PyValueError::new_err)?;
    let config = config(changes).map_err(PyValueError::new_err)?;
    let (next, ended) = (AtomicUsize::new(0), Mutex::default());
    let run = || {
        let work = || {
            work(
                (&driver, &seeds),
                (&options.world, &config),
                (&next, &ended),
            )
        };
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(work)).collect();
            let joined = workers.into_iter().map(|worker| match worker.join() {
                Ok(result) => result,
                Err(panic) => std::panic::resume_unwind(panic),
            });
            // All threads are joined before the first error is reported.
            joined.fold(Ok(()), Result::and)
        })
    };
    py.detach(run).map_err(PyValueError::new_err)?;
    let mut driven: Driven = ended.into_inner().unwrap_or_default();
    driven.0.sort_by_key(|account| account.0);
    Ok(driven)
}

/// Number of bootstrap resamples and their seed, as in `./vlaps eval`.
const RESAMPLES: usize = 4000;
const BOOTSTRAP_SEED: u64 = 95;

/// The mean with its 95 % bootstrap percentile interval; NaN if undefined.
#[pyfunction]
pub fn mean_interval(py: Python, values: Vec<f64>) -> (f64, f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    if values.len() < 2 {
        return (mean, f64::NAN, f64::NAN);
    }
    py.detach(|| {
        let mut stream = Xoshiro256PlusPlus::seed_from_u64(BOOTSTRAP_SEED);
        let count = values.len() as u128;
        // The upper half of the product is uniform within 1 in 2^64.
        let mut draw = || values[((u128::from(stream.next_u64()) * count) >> 64) as usize];
        let mut means: Vec<f64> = (0..RESAMPLES)
            .map(|_| (0..values.len()).map(|_| draw()).sum::<f64>() / values.len() as f64)
            .collect();
        means.sort_by(f64::total_cmp);
        (
            mean,
            means[RESAMPLES / 40],
            means[RESAMPLES - 1 - RESAMPLES / 40],
        )
    })
}
