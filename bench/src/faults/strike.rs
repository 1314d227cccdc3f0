//! A fault strikes a set: how, and what came of it.

use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::Context;
use rustix::process::{Pid, Resource, Rlimit, Signal, prlimit};
use shm_config::Instant;
use shm_config::message::{Fault, FaultKind};
use shm_config::services::Process;
use supervisor::machine::signals::pause;

use super::lies::Told;
use super::room::{Filler, shared_memory};
use super::stage::{LOOK, Stage};
use super::strangers::{Forgery, HeldPlaces, Stranger, hold_loans};
use super::trouble::{Kind, Trouble};
use super::watch::{CHILDREN, Trial};
use lab::stop::Stop;
use stack::Clock;

/// How long a set may take to drive again, ns.
const RECOVERY_NS: u64 = 20_000_000_000;
/// What fills or starves lasts so long at least, ns: a process that dies
/// meanwhile shall meet it.
const LACK_NS: u64 = 50_000_000;
/// ... and so much longer at most, ns.
const LACK_MORE_NS: f64 = 250e6;

/// From forgery to forgery of a stranger, ns: 500 Hz.
const FORGERY_NS: u64 = 2_000_000;

/// What a blow did to the set.
pub enum Blow {
    /// The set goes on, or should.
    Goes {
        /// More about it.
        detail: String,
    },
    /// The supervisor is dead: the set has ended.
    Ended,
    /// The run is beyond help: the supervisor shall end it in order.
    Resigns,
    /// It was no fault on this machine, for this reason.
    Skipped(String),
}

/// What came of a fault.
#[derive(Debug, Clone, Default)]
pub struct Came {
    /// From the fault to the next safe command, or to the vehicle's own brake when
    /// that came first, ns.
    pub safe_ns: Option<u64>,
    /// Which of both: command, brake (a command, too) or vehicle.
    pub by: &'static str,
    /// From the fault to the next safe command, ns; `None` when none came.
    pub command_ns: Option<u64>,
    /// From the fault until every process was up and the car was driven on fresh
    /// inputs, ns; `None` when that never happened.
    pub recovered_ns: Option<u64>,
}

/// Strikes, once the set drives.
///
/// # Errors
/// When the set cannot be watched, or the fault not be made.
pub fn strike(stage: &mut Stage, trouble: &mut Trouble, clock: Clock) -> anyhow::Result<Blow> {
    let period_ns = stage.scene().period_ns();
    stage.watch_for((trouble.phase * period_ns as f64) as u64);
    let lasting_ns = (trouble.periods * period_ns as f64) as u64;
    let lack_ns = LACK_NS + (trouble.periods / 20.0 * LACK_MORE_NS) as u64;
    let target = trouble.target.unwrap_or(Process::Controller);
    let mut detail = String::new();
    let controller = stage.pid(Process::Controller);
    match trouble.kind {
        Kind::Kill => {
            begin(stage, clock);
            stage.signal(target, Signal::KILL);
        }
        Kind::All => {
            let pids = CHILDREN.map(|process| stage.pid(process));
            begin(stage, clock);
            for pid in pids.into_iter().flatten().filter_map(Pid::from_raw) {
                // It may have died of another's death.
                let _ = rustix::process::kill_process(pid, Signal::KILL);
            }
        }
        Kind::Stop => {
            detail = format!("{:.0} ms", lasting_ns as f64 / 1e6);
            begin(stage, clock);
            stage.signal(target, Signal::STOP);
            stage.watch_for(lasting_ns);
            stage.signal(target, Signal::CONT);
        }
        Kind::Hang => order(stage, target, (FaultKind::Hang, 0), clock),
        Kind::Spin => order(stage, target, (FaultKind::Spin, 0), clock),
        Kind::Panic => order(stage, target, (FaultKind::Panic, 0), clock),
        Kind::Allocation => order(stage, target, (FaultKind::Allocation, 0), clock),
        Kind::Slow => {
            detail = format!("{:.0} ms", lasting_ns as f64 / 1e6);
            order(stage, target, (FaultKind::Slow, lasting_ns), clock);
            stage.watch_for(lasting_ns);
        }
        Kind::Memory => {
            let Some(pid) = stage.pid(target).and_then(Pid::from_raw) else {
                return Ok(Blow::Skipped(format!("{target} said no process id")));
            };
            detail = format!("{:.0} ms", lack_ns as f64 / 1e6);
            begin(stage, clock);
            let before = starve(pid)?;
            stage.watch_for(lack_ns);
            // It may have died of it; its successor has the supervisor's limits.
            let _ = prlimit(Some(pid), Resource::As, before);
        }
        Kind::Disk | Kind::Shm => {
            let folder = match trouble.kind {
                Kind::Disk => stage.scene().folder.clone(),
                _ => shared_memory().into(),
            };
            detail = match trouble.kills {
                true => format!("{:.0} ms, killed meanwhile", lack_ns as f64 / 1e6),
                false => format!("{:.0} ms", lack_ns as f64 / 1e6),
            };
            begin(stage, clock);
            let filler = Filler::fill(&folder)?;
            if trouble.kills {
                stage.signal(target, Signal::KILL);
            }
            stage.watch_for(lack_ns);
            drop(filler);
        }
        Kind::Clock => {
            begin(stage, clock);
            step_clock("+1 hour")?;
            stage.watch_for(lack_ns);
            step_clock("-1 hour")?;
        }
        Kind::Hostile => {
            let told = Told::draw(&mut trouble.dice);
            detail = told.to_string();
            begin(stage, clock);
            let now = clock();
            let watch = stage.watch();
            let step = *watch.ledger.newest().context("a step")?;
            let was_told = told.tell(&watch.wire, (&step, now), &mut trouble.dice)?;
            if !was_told {
                detail.push_str(", refused");
            }
        }
        Kind::ForeignCommand => forge(stage, Forgery::Command, lasting_ns, clock)?,
        Kind::OtherEpisode => forge(stage, Forgery::OtherEpisode, lasting_ns, clock)?,
        Kind::ForeignObservation => forge(stage, Forgery::Observation, lasting_ns, clock)?,
        Kind::ForeignPlan => forge(stage, Forgery::PlanAndAdvice, lasting_ns, clock)?,
        Kind::ForgedHealth => forge(stage, Forgery::Health, lasting_ns, clock)?,
        Kind::Slots => {
            detail = format!("{:.0} ms", lack_ns as f64 / 1e6);
            begin(stage, clock);
            let held = HeldPlaces::take(&stage.watch().wire);
            stage.signal(target, Signal::KILL);
            stage.watch_for(lack_ns);
            drop(held);
        }
        Kind::Loans => {
            begin(stage, clock);
            hold_loans(&stage.watch().wire, Duration::from_nanos(lasting_ns))?;
        }
        Kind::Files => {
            begin(stage, clock);
            for path in stage.paths().shared_memory()? {
                // Another process may have removed its own meanwhile.
                let _ = std::fs::remove_file(path);
            }
            let _ = std::fs::remove_dir_all(stage.paths().dir());
            stage.signal(target, Signal::KILL);
            return Ok(Blow::Resigns);
        }
    }
    if trouble.kind == Kind::Kill && target == Process::Supervisor {
        return Ok(Blow::Ended);
    }
    let now = clock();
    let lasts = !(trouble.kind.is_a_death() || trouble.kind.is_a_hang());
    if !lasts && target == Process::Controller {
        // Before the ports are read again.
        stage.doom(controller);
    }
    let watch = stage.watch();
    let struck = watch.trial().map_or(now, |trial| trial.struck);
    watch.over(if lasts { now } else { struck });
    Ok(Blow::Goes { detail })
}

/// Waits until the set drives again, or a stop is asked for; what came of the fault
/// until then.
pub fn await_recovery(
    stage: &mut Stage,
    trouble: &Trouble,
    old_pid: Option<i32>,
    (clock, stop): (Clock, &Stop),
) -> Came {
    let over = stage.watch().trial().and_then(|trial| trial.over);
    let over = over.unwrap_or_else(clock);
    let dies = trouble.kind.is_a_death() || trouble.kind.is_a_hang();
    let until = clock().after_ns(RECOVERY_NS);
    let mut recovered = None;
    while recovered.is_none() && clock() < until && !stage.has_ended() && !stop.is_asked() {
        let watch = stage.watch();
        let fresh = watch.trial().and_then(|trial| trial.fresh);
        let replaced = match (dies, trouble.target) {
            (true, Some(target)) => watch.pid(target) != old_pid,
            _ => true,
        };
        let up = CHILDREN
            .into_iter()
            .all(|process| watch.is_up(process, over));
        if fresh.is_some() && replaced && up {
            recovered = Some(clock());
        }
        pause(LOOK);
    }
    let limits = stage.watch().limits;
    let trial = stage.watch().take_trial();
    trial.map_or_else(Came::default, |trial| came(&trial, &limits, recovered))
}

/// What came of a trial.
pub fn came(trial: &Trial, limits: &super::ledger::Limits, recovered: Option<Instant>) -> Came {
    let own = limits.own_brake(trial.before, trial.anchor);
    let since = |instant: Instant| instant.since_ns(trial.struck);
    let (safe, by) = match trial.command {
        Some((handed, brakes)) if handed <= own => {
            (handed, if brakes { "brake" } else { "command" })
        }
        _ => (own, "vehicle"),
    };
    Came {
        safe_ns: Some(since(safe)),
        by,
        command_ns: trial.command.map(|(handed, _)| since(handed)),
        recovered_ns: recovered.map(since),
    }
}

/// A stranger sends what is well formed for a while.
fn forge(stage: &mut Stage, forgery: Forgery, lasting_ns: u64, clock: Clock) -> anyhow::Result<()> {
    let period_ns = stage.scene().period_ns();
    let mut stranger = Stranger::open(&stage.watch().wire, forgery)?;
    begin(stage, clock);
    let until = clock().after_ns(lasting_ns);
    while clock() < until {
        let step = *stage.watch().ledger.newest().context("a step")?;
        stranger.send(&step, clock(), period_ns);
        stage.watch_for(FORGERY_NS);
    }
    Ok(())
}

fn begin(stage: &mut Stage, clock: Clock) {
    let watch = stage.watch();
    watch.begin(clock());
}

fn order(stage: &mut Stage, target: Process, (kind, duration_ns): (FaultKind, u64), clock: Clock) {
    let mut fault = Fault {
        duration_ns,
        target: target.code(),
        kind: kind.code(),
        ..Fault::default()
    };
    begin(stage, clock);
    let now = clock();
    fault.header.taken_ns = now.0;
    stage.watch().orders.send(&mut fault);
}

/// The process may have no more address space than it has; its limit before.
fn starve(pid: Pid) -> anyhow::Result<Rlimit> {
    let path = format!("/proc/{}/status", pid.as_raw_nonzero());
    let text = std::fs::read_to_string(&path).context(path)?;
    let size = text.lines().find_map(|line| line.strip_prefix("VmSize:"));
    let size = size.and_then(|size| size.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    let none = Rlimit {
        current: None,
        maximum: None,
    };
    let limit = Rlimit {
        current: Some(size.context("VmSize")? * 1024),
        maximum: None,
    };
    match prlimit(Some(pid), Resource::As, limit) {
        Ok(before) => Ok(before),
        // It died a moment ago.
        Err(rustix::io::Errno::SRCH) => Ok(none),
        Err(error) => Err(error).context("prlimit"),
    }
}

fn step_clock(by: &str) -> anyhow::Result<()> {
    let status = Command::new("date")
        .args(["--set", by])
        .stdout(Stdio::null())
        .status()
        .context("date")?;
    anyhow::ensure!(status.success(), "date --set '{by}' was refused");
    Ok(())
}
