//! A running set for views and recorders of other machines: one reader more of the set, as
//! `./vlaps record` is. It has no priority, publishes nothing into the run, and nothing waits
//! for it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use recorder::taps::{self, Tap};
use shm_config::config;
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{Leaves, Process};
use shm_config::wire::Wire;

use crate::host::Seats;
use crate::mirror::remove;
use crate::role::RowId;
use crate::stand_in::clocks;
use crate::station::Station;

/// Time between two reads: at 1,000 Hz five messages, of the 64 that a reader may be behind.
const TURN: Duration = Duration::from_millis(5);
/// Reads between two looks at the supervisor: 0.2 s, because the end of a set waits two
/// seconds for those that read it.
const LOOK_TURNS: u64 = 40;

/// Serves a running set at `HOST:PORT` until it ends or `stop` is set.
///
/// # Errors
/// One line: no such set runs, it is of another build, or has no keys.
pub fn serve(name: &RunName, address: &str, stop: &AtomicBool) -> Result<(), String> {
    let paths = RunPaths::new(name.clone());
    let Some(supervisor) = paths.supervisor_pid() else {
        return Err(format!(
            "run '{name}' is not running; `./vlaps status` shows what runs"
        ));
    };
    let mut config = config::load(&paths.config_file()).map_err(|error| error.to_string())?;
    if let Some(origin) = paths.origin() {
        config.run.folder = origin.folder.display().to_string();
    }
    let wire = Wire::join(name, Process::Recorder).map_err(|error| error.to_string())?;
    wire.follow(supervisor).map_err(|error| error.to_string())?;
    let mut taps = taps::open(&wire).map_err(|error| error.to_string())?;
    taps.retain(|tap| tap.row().leaves != Leaves::No);
    let mut station = Station::open(&config, Seats::Readers, address, clocks().0)?;
    tracing::info!(address, "serves views and recorders");
    for turn in 0_u64.. {
        if stop.load(Ordering::Relaxed) {
            break;
        }
        if turn.is_multiple_of(LOOK_TURNS) && paths.supervisor_pid() != Some(supervisor) {
            tracing::info!("the set has ended");
            break;
        }
        for tap in &mut taps {
            read(tap.as_mut(), &mut station);
        }
        // They send nothing that is taken; the door counts what they try.
        drop(station.receive(clocks()));
        station.send(clocks());
        std::thread::park_timeout(TURN);
    }
    // The run's place is removed when no process is part of it any more, and the network takes
    // a while to close.
    drop(taps);
    drop(wire);
    // The supervisor may have given up waiting for this reader.
    if let Ok(Some(_lock)) = paths.hold_supervisor() {
        remove(&paths);
    }
    station.close(clocks().0);
    Ok(())
}

fn read(tap: &mut dyn Tap, station: &mut Station) {
    tap.update_connections();
    let Some(row) = RowId::of(&tap.channel().service) else {
        return;
    };
    tap.drain(&mut |_, memory, used| {
        station.host.push(row, memory[..used].into());
    });
}
