//! A running set for views and recorders of other machines: one reader more of the set, as
//! `./vlaps record` is. It has no priority, publishes nothing into the run, and nothing waits
//! for it.

use std::mem::offset_of;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use recorder::taps::{self, Tap};
use shm_config::config;
use shm_config::message::{Frame, Observation, Step};
use shm_config::run::{RunName, RunPaths};
use shm_config::services::{FRAME, Leaves, Process, STEP};
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
    let service = tap.channel().service.clone();
    let Some(row) = RowId::of(&service) else {
        return;
    };
    tap.drain(&mut |_, memory| {
        let used = used_bytes(&service, memory);
        station.host.push(row, memory[..used].into());
    });
}

/// How many bytes of a message are used: pixels and beams that are not there do not travel.
fn used_bytes(service: &str, memory: &[u8]) -> usize {
    let number = |at: usize| -> Option<usize> {
        let bytes = memory.get(at..at + 4)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(bytes)).ok()
    };
    let used = match service {
        name if name == FRAME.name => {
            let sides = [offset_of!(Frame, width), offset_of!(Frame, height)];
            let pixels = sides.map(|at| number(at).unwrap_or(usize::MAX));
            let bytes = pixels[0].saturating_mul(pixels[1]).saturating_mul(3);
            offset_of!(Frame, pixels).saturating_add(bytes)
        }
        name if name == STEP.name => {
            // The beams end the observation, which ends the step.
            let end = memory.iter().rposition(|byte| *byte != 0);
            let least = offset_of!(Step, observation) + offset_of!(Observation, ranges_m);
            end.map_or(least, |end| (end + 1).max(least))
        }
        _ => memory.len(),
    };
    used.min(memory.len())
}
