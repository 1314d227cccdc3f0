//! The observation of a living run from outside.

use std::time::Duration;

use shm_config::config::{self, Config};
use shm_config::run::RunPaths;
use shm_config::services::Process;
use shm_config::wire::Wire;

use crate::Clock;
use crate::cli::failure::Failure;
use crate::machine::memory::Memory;
use crate::machine::signals::pause;
use crate::run::leftovers::clean_run;
use crate::set::table::rows;
use crate::telemetry::ports::Ports;
use crate::telemetry::process_tally::ProcessTally;
use crate::telemetry::tally::Tally;

/// How long the processes are listened to, ns: ten heartbeat intervals of 100 ms.
const LISTEN_NS: u64 = 1_000_000_000;
/// Time between two reads.
const LOOK: Duration = Duration::from_millis(20);

/// Listens to a living run for at most `LISTEN_NS`, and reads memory and threads of its
/// processes from the kernel.
///
/// # Errors
/// When the run is starting or ending, or shared memory refuses.
pub fn observe(
    paths: &RunPaths,
    supervisor: u32,
    clock: Clock,
) -> Result<(Config, Tally), Failure> {
    let config = config::load(&paths.config_file()).map_err(|_| {
        Failure::GivenUp(format!(
            "run '{}' is just starting or ending; try again",
            paths.name()
        ))
    })?;
    let mut tally = Tally::default();
    let listened = listen((paths, supervisor), &config, &mut tally, clock);
    // If the run has ended meanwhile, this process has kept its files from removal.
    if paths.supervisor_pid().is_none() {
        clean_run(paths)?;
    }
    listened?;
    for process in rows(&config).map(|row| row.process) {
        let said = tally.process(process).and_then(ProcessTally::newest);
        let Some(pid) = said.map(|health| health.header.producer) else {
            continue;
        };
        tally.count_threads(process, pid);
        if let Some(memory) = Memory::of(pid) {
            tally.count_memory(process, memory);
        }
    }
    Ok((config, tally))
}

fn listen(
    (paths, supervisor): (&RunPaths, u32),
    config: &Config,
    tally: &mut Tally,
    clock: Clock,
) -> Result<(), Failure> {
    let wire = Wire::join(paths.name(), Process::Supervisor)?;
    wire.follow(supervisor)?;
    wire.await_named(Process::Supervisor, supervisor)?;
    let mut ports = Ports::open(&wire)?;
    let begun = clock();
    while clock().since_ns(begun) < LISTEN_NS {
        ports.drain(tally);
        // Only a health message tells the state of a process.
        let said = |process| tally.process(process).and_then(ProcessTally::newest);
        let all = rows(config).all(|row| said(row.process).is_some());
        // Two progress messages of the world: the second shows whether it brakes.
        if all && tally.steps.newest.is_some() && tally.progress_count > 1 {
            break;
        }
        pause(LOOK);
    }
    Ok(())
}
